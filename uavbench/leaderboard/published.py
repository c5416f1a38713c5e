"""The paper's Table III: published figures, which cannot be replayed."""

from dataclasses import dataclass

#: The overall score is the mean over these scenarios.
PAPER_SCENARIOS = ("Manhattan32-CPP-v0", "Manhattan32-DH-v0", "Urban50-CPP-v0", "Urban50-DH-v0")

NAME = "DDQN (paper)"
AUTHORS = "Theile, Bayerlein, Nai, Gesbert, Caccamo"
LINK = "https://arxiv.org/abs/2010.06917"


@dataclass(frozen=True)
class Published:
    """Means over the paper's own 1,000 episodes, as fractions."""

    landed: float
    cr: float
    cral: float


TABLE_3 = {
    "Manhattan32-CPP-v0": Published(0.985, 0.710, 0.703),
    "Manhattan32-DH-v0": Published(0.982, 0.836, 0.825),
    "Urban50-CPP-v0": Published(0.981, 0.815, 0.801),
    "Urban50-DH-v0": Published(0.995, 0.745, 0.742),
}
