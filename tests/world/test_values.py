"""Values from users are read whatever library they come from, and named in messages whatever they are."""

import numpy as np
import pytest

from uavbench.world.values import as_array, as_integer, as_list, shown


class Hostile:
    """An object of which nothing can be asked."""

    def _refuse(self, *_):
        raise ZeroDivisionError

    __repr__ = __index__ = __array__ = __len__ = __iter__ = __getattr__ = __eq__ = __bool__ = _refuse
    __hash__ = None


NO_INTEGERS = [True, np.True_, np.array(True), 1.0, np.float64(1), np.array(1.0), np.array([3]), [3], "3", None, Hostile()]


@pytest.mark.parametrize("value", [3, np.int8(3), np.uint64(3), np.array(3), np.array(3, np.uint8)])
def test_an_integer_is_one_whatever_its_library(value):
    assert as_integer(value) == 3
    assert type(as_integer(value)) is int


@pytest.mark.parametrize("value", NO_INTEGERS, ids=lambda value: type(value).__name__)
def test_what_is_no_integer_is_none(value):
    assert as_integer(value) is None


def test_tensors_are_read_as_arrays_are():
    torch = pytest.importorskip("torch")
    assert as_integer(torch.tensor(3)) == 3
    assert [as_integer(each) for each in as_list(torch.tensor([3, 4]))] == [3, 4]
    assert as_array(torch.tensor([[1.5]])).tolist() == [[1.5]]
    for value in (12.7, True, [3], 3.0):
        assert as_integer(torch.tensor(value)) is None
    assert as_array(torch.ones(2, requires_grad=True)) is None


def test_lists_are_sequences_and_arrays():
    for value in ([1, 2], (1, 2), range(1, 3), np.array([1, 2])):
        assert as_list(value) == [1, 2]
    for value in ("12", b"12", {1, 2}, {1: 2}, 1, np.array(1), None, Hostile(), iter([1, 2])):
        assert as_list(value) is None


def test_arrays_hold_numbers_only():
    assert as_array([[1, 2]]).dtype.kind == "i"
    assert as_array(True).dtype == bool
    assert as_array(np.float16(1.5)).dtype == np.float64
    assert np.isinf(as_array(np.longdouble("1e400")))
    for value in ([[1], [1, 2]], ["1"], [10**400], 1j, None, Hostile(), [Hostile()], object()):
        assert as_array(value) is None


@pytest.mark.parametrize(
    "value",
    [
        Hostile(),
        10**5000,
        "x" * 10**5,
        list(range(10**5)),
        np.zeros((50, 50)),
        np.ones(3),
        {"a": Hostile()},
        [[["x" * 60] * 6] * 6] * 6,
    ],
    ids=type,
)
def test_messages_name_a_value_on_one_short_line(value):
    assert 0 < len(shown(value)) <= 120
    assert "\n" not in shown(value)


def test_messages_name_a_value_as_python_does():
    for value in (3, 12.5, "tset", [0.5, 0], None, np.float64(1.5)):
        assert shown(value) == repr(value)
