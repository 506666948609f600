"""The windows of Nserver as a page for the browser: what it shows, what it may do, how it is served."""
