"""Maps: where a map makes a robot localizable."""
