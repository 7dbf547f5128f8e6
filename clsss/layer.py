"""Light that diffuses within cells wider than the diffusion length: the energy balance of exponential fitting.

Where k h is above a third, k^2 = sigma_a / D, the equation's exact solution along the normal of a cut cell stands
for its linear one (kernels/layer.h). Light is then absorbed between the centroids, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clsss.device import Device
from clsss.diffusion import CHANNELS, Coefficients
from clsss.octree import Octree


@dataclass(frozen=True, eq=False)
class Layer:
    """The fitted layer under the surface.

    Attributes
    ----------
    volume : (n, 3) float64
        Volume that absorbs for each cell of the finest level, or receives from an even source [mm^3].
    conductance : (n_cut, 3) float64
        From the centroid to the outside [mm^2].
    swell : (n_cut, 3) float64
        cosh(k d), d the depth of the centroid: light from the boundary counts so often there for once at the centroid.
    moment : (n_cut, 3) float64
        First moment r_B of an even source q0 = 1 W/mm^3 [mm].
    """

    volume: np.ndarray
    conductance: np.ndarray
    swell: np.ndarray
    moment: np.ndarray


def fitted_layer(device: Device, octree: Octree, medium: Coefficients) -> Layer | None:
    """The layer under the surface, or None where cells resolve the diffusion length."""
    cut, finest, defines = octree.cut, octree.finest, medium.defines
    if not (any(medium.fitted.tolist()) if medium.homogeneous else medium.fitted.shape[0]):
        return None
    factors = [device.empty((cut.n, CHANNELS)) for _ in range(3)]
    geometry = cut.centroid, cut.boundary, cut.normal
    lent = medium.on_device(device)
    common = finest.h, float(medium.fresnel_A), lent.D[-1], lent.sigma_a[-1], medium.fitted
    kernel = device.kernel("layer", "layer_factors", *defines)
    device.run(kernel, cut.n, cut.n, *common, cut.cell, *geometry, *factors)
    conductance, swell, moment = (f.get()[:, :3].astype(float) for f in factors)
    if (swell == 1).all():
        return None
    volume = device.empty((finest.n, CHANNELS))
    kernel = device.kernel("layer", "absorbing_volumes", *defines)
    device.run(kernel, finest.n, finest.n, *common, finest.nbr, octree.cut_index, *geometry,
               device.array(cut.aperture), cut.face_centroid, volume)  # fmt: skip
    return Layer(volume.get()[:, :3].astype(float), conductance, swell, moment)
