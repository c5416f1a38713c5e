"""Where a training computes."""

import pytest
from learning import DDQN, TINY, torch, training
from typer.testing import CliRunner

from uavbench import load_scenario
from uavbench.agents.torch_state import arrays_of, moved, tensor
from uavbench.cli.app import app
from uavbench.learning.device import DEVICES, DeviceError, on_device
from uavbench.learning.train import train

MISSING = [
    name for name, there in (("cuda", torch.cuda.is_available()), ("mps", torch.backends.mps.is_available())) if not there
]


@pytest.mark.parametrize("name", [*MISSING, "abacus"])
def test_a_device_that_is_not_there_is_refused_by_naming_those_that_are(name, tmp_path):
    with pytest.raises(DeviceError, match=f"device {name}: PyTorch finds none here; there is .*cpu"):
        on_device(name)
    with pytest.raises(DeviceError):
        train(training(), tmp_path, device=name)
    told = CliRunner().invoke(app, ["train", "ddqn", "--scenario", "Block8-CPP-v0", "--out", str(tmp_path), "--device", name])
    assert (told.exit_code, "Traceback" in told.output) == (2, False), told.output
    assert not list(tmp_path.iterdir())


def test_auto_takes_a_graphics_card_if_there_is_one():
    with on_device("auto"):
        assert torch.get_default_device().type == next(name for name in ("cuda", "mps", "cpu") if name not in MISSING)
    assert set(DEVICES) == {"auto", "cpu", "cuda", "mps"}


def test_the_context_ends():
    before = torch.get_default_device()
    with torch.device("meta"):
        assert tensor(torch.zeros(2, device="cpu").numpy()).device.type == "meta"
        assert moved(torch.nn.Linear(2, 2, device="cpu")).weight.device.type == "meta"
    assert torch.get_default_device() == before


@pytest.mark.parametrize("name", ["ddqn", "imitation", "ppo"])
def test_a_network_begins_with_the_same_weights_on_every_device(name, monkeypatch):
    """Random numbers of another device are others, so networks must be made on the processor. "meta" has no numbers at all."""
    from uavbench.agents.agent import find_agent

    module = find_agent(name).module()
    config = TINY if module is DDQN else module.CONFIGS["fast"]
    seen = []

    def note(network):
        seen.append(arrays_of(network))
        raise InterruptedError

    monkeypatch.setattr(module, "moved", note)
    for device in ("cpu", "meta"):
        with torch.device(device), pytest.raises(InterruptedError):
            module.Learner(load_scenario("Block8-CPP-v0"), config, 0)
    first, second = ({key: array.tobytes() for key, array in arrays.items()} for arrays in seen)
    assert first == second
