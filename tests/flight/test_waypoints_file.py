"""Waypoint files: pymavlink reads the mission from them."""

import pytest

from uavbench.flight.waypoints_file import waypoints_text

mavwp = pytest.importorskip("pymavlink.mavwp")


def test_pymavlink_reads_the_mission(mission, tmp_path):
    path = tmp_path / "a.waypoints"
    path.write_text(waypoints_text(mission), encoding="utf-8")
    loader = mavwp.MAVWPLoader()
    items = mission.items()
    assert loader.load(str(path)) == 1 + len(items)
    home = loader.wp(0)
    assert (home.x, home.y, home.current) == (pytest.approx(mission.home()[0]), pytest.approx(mission.home()[1]), 1)
    for k, item in enumerate(items):
        found = loader.wp(k + 1)
        assert (found.seq, found.command, found.frame) == (k + 1, item.command, item.frame)
        assert (found.current, found.autocontinue) == (0, 1)
        assert (found.param1, found.param2, found.param3, found.param4) == pytest.approx(item.params, abs=1e-4)
        assert (found.x, found.y, found.z) == pytest.approx(item.place, abs=1e-7)
