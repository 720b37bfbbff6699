"""Arms in files of other programs."""
