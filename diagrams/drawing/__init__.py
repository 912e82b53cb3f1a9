"""Everything that is drawn: numbers in, one file out."""

FILM_FORMATS = (".webp", ".gif")
PLOT_FORMATS = (".png", ".svg", ".pdf")  # of a figure; here, where no drawing library need be loaded to ask
