"""Training: PPO of Stable-Baselines3 on our slots, and the export of what it learned.

Needs the extra ``pip install "ptne-env[sb3]"``.
"""
