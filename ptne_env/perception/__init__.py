"""What a policy sees, and how it answers.

- ``fields``: the table of all that an observation may have
- ``observation``: interfaces, and the layout of observations and actions, which is all that a policy knows
- ``encoder``: writes the observations of a running world, and turns actions into inputs
- ``policy``: the signature ``predict``
"""
