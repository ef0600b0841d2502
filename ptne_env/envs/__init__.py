"""Adapters, without physics, to PettingZoo, Gymnasium, Stable-Baselines3 and TorchRL, one module each."""
