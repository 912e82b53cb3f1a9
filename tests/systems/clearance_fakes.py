"""A point in a plane before walls: what it is near to can be worked out by hand."""

import numpy as np

from systems.clearance_filter import ClearanceFilter, Near


class Walls:
    """A Map for a point whose two joint angles are its coordinates (m); a wall is a normal and an offset.

    The distance to it is normal . q - offset; `margin`: that each is to be kept beyond the gap; `reach`: what each
    joint is said to move the point by at most, m/rad.
    """

    obstacle_size = 0

    def __init__(self, *walls, margin=0.0, reach=(1.0, 1.0)):
        self.margin = margin
        self.normals = np.array([wall[0] for wall in walls], float).reshape(-1, 2)
        self.offsets = np.array([wall[1] for wall in walls], float)
        self.reach = np.array(reach)

    def view(self, posture, obstacles, returning=True):
        return self

    def near(self, joints, within):
        distances = self.normals @ joints - self.offsets
        seen = distances < within
        return Near(distances[seen], self.normals[seen], np.flatnonzero(seen), np.full(sum(seen), self.margin))

    def nearest(self, joints, within, but):
        near = self.near(joints, within)
        return near.distances[~np.isin(near.pairs, but)].min(initial=within)


class Post(Walls):
    """A round post at the origin."""

    def __init__(self, radius):
        super().__init__()
        self.radius = radius

    def near(self, joints, within):
        length = np.linalg.norm(joints)
        if length - self.radius >= within:
            return super().near(joints, within)
        return Near(np.array([length - self.radius]), joints[None] / length, np.zeros(1, int), np.zeros(1))


class ToldWall(Walls):
    """A wall ahead in the first coordinate, at the place that the map is told."""

    obstacle_size = 1

    def view(self, posture, obstacles, returning=True):
        return Walls(((-1.0, 0.0), -obstacles[0]))


def make_filter(map, **changes) -> ClearanceFilter:
    arguments = dict(posture_size=3, joints=2, lower=-np.ones(3), upper=np.ones(3), max_step=np.full(2, 0.5))
    return ClearanceFilter(map, **arguments | changes)
