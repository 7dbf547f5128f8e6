"""An orbiting perspective camera: angles and a target to a matrix.

Input: azimuth and elevation [degrees], lengths [mm]; output: 4 x 4 matrices for column vectors, as OpenGL's
clip space wants them (-1 to 1 on every axis).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

FIELD_OF_VIEW = 32.0  # vertical, degrees: near what a portrait lens sees
MARGIN = 0.88  # share of the picture that a fitted object fills


@dataclass(frozen=True, eq=False)
class Camera:
    """Where the eye is and what it looks at.

    Parameters
    ----------
    target : (3,) ndarray
        Point in the middle of the picture [mm].
    distance : float
        From the eye to the target [mm].
    azimuth : float
        Degrees to the right around the up axis; 0 looks from +z if y is up, from -y if z is up.
    elevation : float
        Degrees above the horizon, within -89 and 89.
    up : {"y", "z"}
        The axis that points up.
    """

    target: np.ndarray
    distance: float
    azimuth: float = 0.0
    elevation: float = 0.0
    up: str = "y"

    @property
    def eye(self) -> np.ndarray:
        """Where the eye is (3,) [mm]."""
        return self.target + self.distance * self.axes()[2]

    def axes(self) -> np.ndarray:
        """Right, up and towards the eye, as the rows of a rotation (3, 3)."""
        a, e = np.radians([self.azimuth, self.elevation])
        right = np.array([np.cos(a), 0.0, -np.sin(a)])
        back = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
        rows = np.stack([right, np.cross(back, right), back])
        return rows if self.up == "y" else np.stack([rows[:, 0], -rows[:, 2], rows[:, 1]], axis=1)

    def orbited(self, right: float, over: float) -> Camera:
        """The camera moved around its target by degrees; it never tips over."""
        elevation = float(np.clip(self.elevation + over, -89, 89))
        return replace(self, azimuth=self.azimuth + right, elevation=elevation)

    @property
    def picture_height(self) -> float:
        """What the picture shows from top to bottom at the target [mm]."""
        return float(2 * self.distance * np.tan(np.radians(FIELD_OF_VIEW) / 2))

    def panned(self, right: float, over: float) -> Camera:
        """The camera moved by shares of the picture's height."""
        aside = np.array([right, over]) @ self.axes()[:2]
        return replace(self, target=self.target + self.picture_height * aside)

    def zoomed(self, factor: float) -> Camera:
        """The camera `factor` times closer to its target."""
        return replace(self, distance=self.distance / factor)

    def matrix(self, aspect: float, radius: float) -> np.ndarray:
        """World to clip space.

        Parameters
        ----------
        aspect : float
            Width of the picture over its height.
        radius : float
            Of a ball around the target that must not be cut by the near or the far plane [mm].

        Returns
        -------
        (4, 4) ndarray
        """
        near = max(self.distance - radius, 1e-3 * self.distance)
        far = self.distance + radius
        focal = 1 / np.tan(np.radians(FIELD_OF_VIEW) / 2)
        projection = np.diag([focal / aspect, focal, (far + near) / (near - far), 0.0])
        projection[2, 3], projection[3, 2] = 2 * far * near / (near - far), -1.0
        view = np.eye(4)
        view[:3, :3] = self.axes()
        view[:3, 3] = -self.axes() @ self.target - (0.0, 0.0, self.distance)
        return projection @ view


def fitted(points: np.ndarray, camera: Camera, aspect: float) -> Camera:
    """The camera, moved so that it sees all points (n, 3) as large as they can be, in the middle.

    Each picture axis asks for ``|x - target| <= share * (distance - depth)`` at every point, which the
    two extreme planes of the points settle exactly.
    """
    centre = points.mean(axis=0)
    right, over, back = camera.axes() @ (points - centre).T
    slope = MARGIN * np.tan(np.radians(FIELD_OF_VIEW) / 2)
    shift, distance = [], 0.0
    for across, share in ((right, slope * aspect), (over, slope)):
        high, low = (across + share * back).max(), (-across + share * back).max()
        shift.append((high - low) / 2)
        distance = max(distance, (high + low) / 2 / share)
    target = centre + shift @ camera.axes()[:2]
    return replace(camera, target=target, distance=distance)
