"""The switched loop as one hybrid system: an analysis a file."""
