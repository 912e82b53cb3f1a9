"""Many episodes: tasks, rows on disk, statistics."""
