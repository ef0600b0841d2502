"""Adapters, without physics, to PettingZoo, Gymnasium and Stable-Baselines3, one module each."""
