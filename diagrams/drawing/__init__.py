"""Everything that is drawn: numbers in, one file out."""

PLOT_FORMATS = (".png", ".svg", ".pdf")  # of a figure; here, where no drawing library need be loaded to ask
