"""A body with a camera in a world: places, episodes, rules, and the environment that all simulated tasks share."""

__all__: list[str] = []  # the names are those of the modules
