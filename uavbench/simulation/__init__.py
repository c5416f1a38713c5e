"""The rules of the world: the state of a batch of episodes, how a step changes it, its observations, and the missions."""
