"""Maps looked at with a filter's eyes: where they let it know where it is, and where they do not."""
