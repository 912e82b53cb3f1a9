"""Everything that is drawn: numbers in, one file out."""
