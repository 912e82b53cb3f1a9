"""The page of live.py: what runs behind it, what it shows, and how it is served."""
