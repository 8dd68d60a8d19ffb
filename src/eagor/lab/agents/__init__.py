"""Who plays: estimators of direction (ours, the paper's, their rivals), policies that walk, models that are asked."""

__all__: list[str] = []  # the names are those of the modules
