"""Flies a recorded episode again, and returns a scene for each of its steps."""

from uavbench.drawing.scene import Scene, scene_of
from uavbench.drawing.trail import Trail
from uavbench.evaluation.replay import flown_in, fly_recorded
from uavbench.evaluation.results import Result, ResultError
from uavbench.flight.own import Own
from uavbench.simulation.simulator import Simulator
from uavbench.world.episode import split_size


def recorded_scenes(result: Result, episode: int, scenario_file: str | None = None) -> list[Scene]:
    """Fly an episode of a result again; return the scenes at the start and after every step.

    Parameters
    ----------
    result : Result
    episode : int
    scenario_file : str, optional
        The scenario's file, if it is a user's own and has moved.

    Raises
    ------
    ResultError
        When the scenario is not that of the result, or the result does not hold the episode or only a part of it.
    """
    scenario, split = flown_in(result, scenario_file)
    actions = result.actions()
    if episode not in actions or episode >= split_size(scenario, split):
        raise ResultError(f"--episode: {episode} is not one of the episodes 0 to {len(actions) - 1} of {result.folder}")
    trails: list[Trail] = []
    scenes: list[Scene] = []

    def watch(simulator: Simulator) -> None:
        if trails:
            trails[0].extend()
        else:
            trails.append(Trail(simulator, 0))
        scenes.append(scene_of(simulator, 0, trails[0]))

    if fly_recorded(scenario, split, episode, actions[episode], watch) is None:
        raise ResultError(f"{result.folder / 'actions.npz'}: does not hold the actions of the whole episode {episode}")
    return scenes


def own_scene(own: Own) -> Scene:
    """Return the scene at the end of a flight that was planned with targets of a person's own."""
    simulator = Simulator(own.flight.scenario, 1)
    simulator.reset([0], own.flight.split, [own.flight.episode])
    simulator.customise(0, own.options)
    trail = Trail(simulator, 0)
    for row in own.actions:
        simulator.step(row)
        trail.extend()
    return scene_of(simulator, 0, trail)
