"""Recording of connections to files, and replaying them."""
