"""What a filter held to be true when its program ended, and its file: kept_file > kept."""
