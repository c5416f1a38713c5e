"""PyTorch: a module that expands compact observations to what networks take. Needs PyTorch (the extra ``ddqn`` has it)."""

# pyright: basic, reportMissingImports=false
import torch
from torch import Tensor, nn

from uavbench.envs.forms import Form
from uavbench.world.scenario import Scenario


class Expand(nn.Module):
    """Expands a batch of compact observations (``compact=True``) to the usual float32 ones, bit for bit, on any device.

    Parameters
    ----------
    scenario : Scenario
        The scenario of the environment that made the observations: ``env.scenario``.

    Examples
    --------
    >>> import torch, uavbench
    >>> from uavbench.integrations.torch import Expand
    >>> envs = uavbench.make_vec("Manhattan32-CPP-v0", num_envs=8, compact=True)
    >>> small, _ = envs.reset(seed=0)
    >>> usual = Expand(envs.scenario)({name: torch.from_numpy(values) for name, values in small.items()})
    >>> usual["local"].shape, usual["local"].dtype
    (torch.Size([8, 4, 17, 17]), torch.float32)
    """

    def __init__(self, scenario: Scenario) -> None:
        super().__init__()
        self._shapes = Form(scenario, compact=True).shapes
        self._area = scenario.observation.global_scale**2

    def forward(self, observation: dict[str, Tensor]) -> dict[str, Tensor]:
        """Return the usual observations; ``budget`` stays as it is."""
        found = {"budget": observation["budget"]}
        for name, (layers, high, wide) in self._shapes.items():
            if name not in observation:
                continue
            maps = observation[name].float() / (self._area if name == "global" else 1)
            if f"{name}_target" in observation:
                row, col, value = observation[f"{name}_target"].unbind(dim=2)
                target = torch.zeros(len(maps), high * wide, device=maps.device)
                target.scatter_add_(1, (row * wide + col).long(), value)  # rows of zeros add 0 to the first cell
                maps = torch.cat([maps, target.reshape(len(maps), 1, high, wide)], dim=1)
            assert maps.shape[1] == layers
            found[name] = maps
        return found
