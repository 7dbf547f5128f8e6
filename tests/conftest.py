"""What the tests share: the device in both precisions, and the folder of reference data."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from clsss.device import Device
from clsss.errors import DeviceError


def _open(precision: str) -> Device:
    try:
        return Device(precision=precision)
    except DeviceError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def single() -> Device:
    """The best device, in float32."""
    return _open("single")


@pytest.fixture(scope="session")
def double() -> Device:
    """The best device, in float64: for orders of accuracy and exact identities."""
    return _open("double")


@pytest.fixture(scope="session", params=["single", "double"])
def device(request: pytest.FixtureRequest) -> Device:
    """The best device, once in each precision."""
    return request.getfixturevalue(request.param)


@pytest.fixture(scope="session")
def eps(device: Device) -> float:
    """Spacing of the device's numbers at 1."""
    return float(np.finfo(device.real).eps)


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder of reference data, which the repository does not hold."""
    folder = os.environ.get("CLSSS_SHARED")
    if not folder:
        pytest.skip("reference data: set CLSSS_SHARED to their folder")
    return Path(folder)
