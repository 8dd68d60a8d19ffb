"""The lab: simulated worlds and published data, tasks in them, agents that play, and what their runs come to.

Five floors, each of which imports only those before it: `eagor.lab.worlds`, `eagor.lab.envs` (a body with a camera in
a world), `eagor.lab.agents` (who says a direction, and who walks), `eagor.lab.tasks` (what is asked, and how it is
scored), `eagor.lab.eval` (runs, their records, statistics and reports).
"""

__all__: list[str] = []  # the names are those of the modules
