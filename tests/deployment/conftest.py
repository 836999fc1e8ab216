"""A small recording with exact angles: a room with four boards and one or two tags."""

import numpy as np
import pytest

from aoabench.maths.geometry import wrap

ANCHORS = {"A1": (0, 3, 2.3, 0), "A2": (6, 0, 2.3, 90), "A3": (12, 3, 2.3, 180), "A4": (6, 6, 2.3, -90)}  # fmt: skip
POINTS = np.array([[3, 2, 1.1], [9, 4, 1.1], [5, 3, 1.1], [7, 2, 1.1]])


def angles(point, anchor, turned=0.0):
    """Azimuth and elevation in deg that an anchor measures, whose facing is stated wrong by `turned`."""
    x, y, z, facing = ANCHORS[anchor]
    d = np.asarray(point) - (x, y, z)
    azimuth = wrap(np.arctan2(d[1], d[0]) - np.radians(facing + turned))
    return np.degrees(azimuth), np.degrees(np.arctan2(d[2], np.hypot(d[0], d[1])))


def rows_of(points, tag=None, turned=(), times=None, anchors=ANCHORS):
    """The rows of a log: for each point (T, 3) a row of each anchor."""
    rows = []
    for k, point in enumerate(points):
        for name in anchors:
            a, e = angles(point, name, dict(turned).get(name, 0.0))
            at = k if times is None else times[k]
            rows.append(f"{at},{'' if tag is None else tag + ','}{name},{a:.9f},{e:.9f}")
    return rows


@pytest.fixture
def room(tmp_path):
    """The folder with anchors.csv and walls.geojson."""
    lines = [f"{name},{','.join(map(str, place))}" for name, place in ANCHORS.items()]
    (tmp_path / "anchors.csv").write_text("\n".join(["id,x_m,y_m,z_m,facing_deg", *lines]) + "\n")
    corners = "[[0, 0], [12, 0], [12, 6], [0, 6], [0, 0]]"
    walls = f'{{"type": "Feature", "properties": {{}}, "geometry": {{"type": "LineString", "coordinates": {corners}}}}}'
    (tmp_path / "walls.geojson").write_text(
        f'{{"type": "FeatureCollection", "features": [{walls}]}}'
    )
    return tmp_path


@pytest.fixture
def log(room):
    """The function (rows, header) -> the path of a log."""

    def write(rows, header="fix,anchor,azimuth_deg,elevation_deg", name="log.csv"):
        path = room / name
        path.write_text("\n".join([header, *rows]) + "\n")
        return path

    return write
