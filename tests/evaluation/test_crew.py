"""The pieces in which a cluster is given episodes: each episode once, enough pieces for all cores, and not many small ones."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.evaluation.crew import pieces
from uavbench.evaluation.evaluate import Job


def job(agent):
    return Job(find_agent(agent), load_scenario("Block8-DH-v0"), "train")


ONE_BY_ONE, BATCHES = job("tsp"), job("random")


@given(st.integers(1, 20_000), st.integers(0, 1_000), st.booleans())
def test_each_episode_is_in_one_piece_and_no_core_is_left_without(episodes, cores, batches):
    cut = pieces(BATCHES if batches else ONE_BY_ONE, range(3, 3 + episodes), cores)
    assert [number for piece in cut for number in piece] == list(range(3, 3 + episodes))
    most = max(len(piece) for piece in cut)
    assert most <= (BATCHES.batch_size if batches else 50)
    sizes = [len(piece) for piece in cut]
    assert sizes == sorted(sizes, reverse=True)
    assert all(size == most for size in sizes[:-1]) or not batches
    assert sizes[-1] == 1 or batches
    assert batches or len(cut) >= min(episodes, cores)
    assert most <= -(-episodes // max(1, cores))  # as many as if all cores had the same, at most


@pytest.mark.parametrize(
    ("agent", "episodes", "cores", "count"),
    [
        (ONE_BY_ONE, 1_000, 2, 35),
        (ONE_BY_ONE, 1_000, 1_000, 1_000),
        (ONE_BY_ONE, 1_000_000, 1_000, 28_956),
        (BATCHES, 1_000, 2, 4),
        (BATCHES, 1_000, 100, 100),
    ],
)
def test_many_episodes_come_in_large_pieces(agent, episodes, cores, count):
    assert len(pieces(agent, range(episodes), cores)) == count
