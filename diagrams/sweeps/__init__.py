"""Many episodes: what is asked for, tasks, a cluster, the table of all rows, statistics."""
