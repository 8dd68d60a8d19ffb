"""No two modules import each other, whichever way round: not inside functions, not for types alone.

`lint-imports` forbids circles among the modules of a package; this sees those through a package's own file, too.
"""

from graphlib import TopologicalSorter

import grimp


def test_no_module_imports_itself_by_a_detour():
    graph = grimp.build_graph("eagor", cache_dir=None)
    imports = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    assert len(imports) > 100, "the graph is that of the package"
    TopologicalSorter(imports).prepare()  # raises CycleError, which names a circle
