"""Light that diffuses within cells wider than the diffusion length: the energy balance of exponential fitting.

Where k h is above a third, k^2 = sigma_a / D, the equation's exact solution along the normal of a cut cell stands
for its linear one (kernels/layer.h). Light is then absorbed between the centroids, too.
"""

from __future__ import annotations

from dataclasses import dataclass

from clsss.device import Device
from clsss.diffusion import Coefficients
from clsss.fields import CHANNELS
from clsss.octree import Octree
from clsss.stowed import Stowed, stow


@dataclass(frozen=True, eq=False)
class Layer:
    """The fitted layer under the surface.

    Attributes
    ----------
    volume : Stowed (n, 3) float64
        Volume that absorbs for each cell of the finest level, or receives from an even source [mm^3].
    conductance : Stowed (n_cut, 3) float64
        From the centroid to the outside [mm^2].
    swell : Stowed (n_cut, 3) float64
        cosh(k d), d the depth of the centroid: light from the boundary counts so often there for once at the centroid.
    moment : Stowed (n_cut, 3) float64
        First moment r_B of an even source q0 = 1 W/mm^3 [mm].
    """

    volume: Stowed
    conductance: Stowed
    swell: Stowed
    moment: Stowed


def fitted_layer(device: Device, octree: Octree, medium: Coefficients) -> Layer | None:
    """The layer under the surface, or None where cells resolve the diffusion length."""
    cut, finest, defines = octree.cut, octree.finest, medium.defines
    if not medium.any_fitted:
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
               cut.aperture.on_device(device), cut.face_centroid, volume)  # fmt: skip
    volumes = Stowed((finest.n, 3), float, lambda first, n: volume.get(first, n)[:, :3])
    return Layer(volumes, stow(conductance), stow(swell), stow(moment))
