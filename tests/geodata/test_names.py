"""The id and the mission of an imported city: from the name of the file, from --id and from --mission."""

from pathlib import Path

import pytest

from uavbench.geodata.libraries import GeodataError
from uavbench.geodata.names import name_city, place_of


@pytest.mark.parametrize(
    ("file", "wanted", "mission", "expected"),
    [
        ("my_city.toml", None, None, ("MyCity-CPP-v0", "cpp")),
        ("my_city.toml", None, "dh", ("MyCity-DH-v0", "dh")),
        ("Helsinki50-DH-v3.toml", None, None, ("Helsinki50-DH-v3", "dh")),
        ("helsinki50-dh-v3.toml", None, None, ("helsinki50-dh-v3", "dh")),
        ("Helsinki50-DH-Long-v3.toml", None, None, ("Helsinki50-DH-Long-v3", "dh")),
        ("Helsinki50-DH-v3.toml", None, "dh", ("Helsinki50-DH-v3", "dh")),
        ("Helsinki-DH.toml", None, None, ("Helsinki-DH-v0", "dh")),
        ("old town cpp.toml", None, "cpp", ("OldTown-CPP-v0", "cpp")),
        ("dh.toml", None, None, ("City-DH-v0", "dh")),
        ("a.toml", "A-DH-v0", None, ("A-DH-v0", "dh")),
        ("a.toml", "DH-CPP-v0", None, ("DH-CPP-v0", "cpp")),  # a place that is called DH
        ("a.toml", "A-v0", None, ("A-v0", "cpp")),
        ("a.toml", "A-v0", "dh", ("A-v0", "dh")),
        ("a-cpp.toml", "A-DH-v0", None, ("A-DH-v0", "dh")),
    ],
)
def test_the_mission_is_the_one_that_the_id_names(file, wanted, mission, expected):
    assert name_city(Path(file), wanted, mission) == expected


@pytest.mark.parametrize(
    ("file", "wanted", "mission", "reason"),
    [
        (
            "a.toml",
            "A-DH-v0",
            "cpp",
            "mission: cpp contradicts the id A-DH-v0, which names DH: leave out --mission, or .* --id",
        ),
        ("A-CPP-v0.toml", None, "dh", "mission: dh contradicts the name of the file A-CPP-v0, which names CPP: .* --out"),
        ("my dh.toml", None, "cpp", "mission: cpp contradicts the name of the file my dh"),
        ("a.toml", "my town", None, "id: 'my town' is not of the form expected, as in MyCity-CPP-v0"),
        ("a.toml", "", None, "id: '' is not of the form expected"),
        ("a.toml", "A\nB-v0", None, "id: 'A.nB-v0' is not of the form expected"),
        ("a.toml", "A-v٣", None, "is not of the form expected"),
        ("a.toml", f"{'A' * 200}-v0", None, "id: 'A+'… has 203 characters: at most 100 are allowed"),
    ],
)
def test_an_id_that_is_wrong_or_contradicts_the_mission_is_refused(file, wanted, mission, reason):
    with pytest.raises(GeodataError, match=reason) as told:
        name_city(Path(file), wanted, mission)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(
    ("stem", "name"),
    [
        ("Städt 城", "Stadt-CPP-v0"),
        ("São Paulo", "SaoPaulo-CPP-v0"),
        ("straße_ø", "StrasseO-CPP-v0"),
        ("Łódź", "Lodz-CPP-v0"),
        ("İzmir Çarşı", "IzmirCarsi-CPP-v0"),
        ("大cit大y", "City-CPP-v0"),
        ("大", "City-CPP-v0"),
        ("Town²", "Town2-CPP-v0"),
        ("l'aquila–vecchia", "LAquilaVecchia-CPP-v0"),
        ("x" * 95, f"X{'x' * 92}-CPP-v0"),
    ],
)
def test_ids_keep_their_letters(stem, name):
    assert name_city(Path(f"{stem}.toml"), None, None) == (name, "cpp")


@pytest.mark.parametrize(
    ("name", "place"),
    [("Helsinki50-DH-v3", "Helsinki50"), ("A-dh-Long-v0", "A-Long"), ("Old-Town-v12", "Old-Town"), ("DH-v0", "DH")],
)
def test_the_name_of_the_place_is_without_the_mission(name, place):
    assert place_of(name) == place
