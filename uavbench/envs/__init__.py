"""Adapters: Gymnasium's ``Env`` and ``VectorEnv`` over the simulator. No rule of the world is in them."""
