"""The physics: parts of a scenario, the world that builds them, and the transition."""
