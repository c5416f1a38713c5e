"""Flying agents in tests."""

from uavbench import load_scenario
from uavbench.agents.agent import find_agent
from uavbench.envs.env import UAVEnv
from uavbench.evaluation.evaluate import Job, evaluate
from uavbench.simulation.state_view import StateView


def fly(name, agent, numbers):
    """Return the records of an agent's test episodes, by number."""
    return {r.episode: r for r in evaluate(Job(find_agent(agent), load_scenario(name), "test"), numbers)}


def fly_world(agent, world, **options):
    """Fly one episode, which ``options`` set as in `UAVEnv.reset`; return its actions and the last info."""
    flown, env = find_agent(agent).make(world), UAVEnv(world)
    observation, info = env.reset(seed=0, options=options)
    flown.reset(info)
    actions, over = [], False
    while not over:
        actions.append(flown.act(observation, {**info, "state": StateView(env.simulator, 0)}))
        observation, _, over, _, info = env.step(actions[-1])
    return actions, info


def check_forgets(agent, name):
    """Check that an agent whose last episode was broken off begins the next one in the same way as a new agent."""
    world = load_scenario(name)
    env = UAVEnv(world)

    def begin(flown, episode):
        observation, info = env.reset(options={"split": "validation", "episode": episode})
        flown.reset(info)
        actions = []
        for _ in range(10):
            actions.append(flown.act(observation, {**info, "state": StateView(env.simulator, 0)}))
            observation, _, _, _, info = env.step(actions[-1])
        return actions

    used = find_agent(agent).make(world)
    for episode in range(6):
        assert begin(used, episode) == begin(find_agent(agent).make(world), episode)
