"""One episode.

What is sampled, how it runs, what is recorded, how its switching is judged, and many of them in parallel.
"""
