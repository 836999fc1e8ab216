"""The units and the meanings of columns."""

import pytest

from aoabench.columns import REPLICATIONS, STEPS, SUMMARY, TABLES, TIMING, meaning, unit_of


@pytest.mark.parametrize(("name", "unit"), [
    ("rmse_3d_m", "m"), ("cov_xy_m2", "m^2"), ("time_s", "s"), ("noise.sigma_deg", "deg"), ("scenario.speed_m_s", "m/s"),
    ("seconds_per_step", "s"), ("noise.power_dbm", "dBm"), ("noise.shadowing_db", "dB"), ("noise.carrier_ghz", "GHz"),
    ("nees", ""), ("replication", ""), ("n_ok", ""), ("x", ""), ("m", ""), ("reps", ""),
])  # fmt: skip
def test_unit_of(name, unit):
    assert unit_of(name) == unit


def test_every_length_of_the_tables_has_its_unit():
    for table in (REPLICATIONS, STEPS, SUMMARY, TIMING):
        for name in table:
            known = "m" if name.endswith("_m") else "m^2" if name.endswith("_m2") else None
            assert known is None or unit_of(name) == known


@pytest.mark.parametrize("table", TABLES)
def test_every_column_of_the_tables_has_its_meaning(table):
    for name in TABLES[table]:
        assert meaning(name).strip()
    with pytest.raises(KeyError):
        meaning("n")
