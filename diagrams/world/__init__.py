"""The task and its world: scenario, station, kinematics, collisions, goals, teacher.

The only room that knows of cans and shelves.
"""
