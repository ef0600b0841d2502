"""Programs that train, tune and publish, and the numbers that they wrote; ``README.md`` says which does what."""
