"""Files that the pages load."""
