"""The rules of the world: the state of a batch of episodes, a step of it, its observation, and the missions."""
