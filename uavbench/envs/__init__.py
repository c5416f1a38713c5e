"""Adapters of the simulator for Gymnasium (``Env``, ``VectorEnv``) and PettingZoo. They contain no rules of the world."""
