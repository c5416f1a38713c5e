"""Missions as the plain text that Mission Planner, MAVProxy and others read: ``QGC WPL 110``.

The format: https://mavlink.io/en/file_formats/
"""

from uavbench.flight.mission import WAYPOINT, Item, Mission

_GLOBAL = 0  # MAV_FRAME: an altitude above the sea


def waypoints_text(mission: Mission) -> str:
    """Return the text of the file. The first item is the place of take-off.

    A warning is a line that begins with ``#``. Mission Planner and MAVProxy skip it; others may refuse the file.
    """
    lat, lon = mission.home()
    items = [Item(WAYPOINT, _GLOBAL, place=(lat, lon, 0.0)), *mission.items()]
    lines = ["QGC WPL 110", *([f"# {mission.warning}"] if mission.warning else [])]
    for number, item in enumerate(items):
        values = [number, int(number == 0), item.frame, item.command, *item.params]
        places = [f"{item.place[0]:.7f}", f"{item.place[1]:.7f}", f"{item.place[2]:g}"]
        lines.append("\t".join([*(f"{value:g}" for value in values), *places, "1"]))
    return "\n".join(lines) + "\n"
