"""The source as a whole: no circles of imports, and no names that have left it; and tests in real time are a group."""

import ast
import os
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest

import eagor

SOURCE = Path(eagor.__file__).parent

GONE = {  # room: names, without the underscore of private ones; "" is every room
    "": """LookPlan Keeper Shot Feed FrameCame PoseCame EvidenceCame AllCame Asked Following PosesLost Trouble Told
    told_by_photograph Around Surroundings what_else united is_same lift Placed framed Asker Unfit Turned turn_between
    agreeing_rotation agreeing_motion Agreement doubt log_chance Parts part_of_sphere Journey journey_of posed_by_sight
    posed_by_motion thinned makers made_of Panoramas sureness hub following Slot Kept Punctual Redrawn Library rivals
    Lateness RelatedClock keep_picture FileSlot Played Player Recording Sighting Method Steers method_for make_method
    Study studies Simulated Published several Planned Worst Book Seat ProcessSeat ActorSeat give_back Lost Unsent
    work_together work_on_ray carry_out ledger inputs_of Gap gap few_groups Sheet headed Carrier Disturbances handover
    appears Approach in_vain held looks_down undone Walkable Way Field touched pulled Looker TruthEye PixelEye
    BeliefLooker Drawings stretches strange Link told_on_graph told_in_bag LensTold placed_on_graph Outbox
    OutgoingAnswer Stamps queries_after Wish Doing Watch GateClient GuardState calm_codes deaf careful examine
    ForeignCommands direction_pose HiddenParts NeverSeen ThingSeen is_of meant read_with StreamClock TopicPictures
    placed_in_bag panorama_of pose_of surroundings""",
    "_extras": "need",
    "_files": "written",
    "belief": "reading",
    "cli": "joined mistake footage",
    "drawing": "Moment drawn",
    "evidence": "Alarms inverse anew joint mapped",
    "lab": "Moment look play settle offer judge judged alike Rows laid_out",
    "live": "Body united",
    "sources": "Lenses",
    "perception": "look need Thing things Seen Found kept overlaps place corners upright opened words lift drawn",
    "robots": "Body Motion Sight Walk Thing Moment slide settle tell call heard Report",
    "studio": "eye guard hub weighed",
    "tracking": "Look Moment look follower hypotheses looking explained mapped joint silent",
}


def names(body):
    """Of classes and functions, and of what is in the classes; what is in functions is local."""
    for each in body:
        if isinstance(each, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield each.name
        if isinstance(each, ast.ClassDef | ast.If):
            yield from names(each.body)


def test_no_old_name_comes_back():
    found = set()
    for path in SOURCE.rglob("*.py"):
        room, *inner = path.relative_to(SOURCE).with_suffix("").parts
        old = set(f"{GONE['']} {GONE.get(room, '')}".split())
        here = {name.lstrip("_") for name in names(ast.parse(path.read_text(encoding="utf-8")).body)} | {*inner}
        found |= {f"{room}.{name}" for name in old & here}
    assert not found


def test_no_module_imports_itself_by_a_detour():
    """Not inside functions, not for types alone; `lint-imports` does not see those through a package's own file."""
    graph = grimp.build_graph("eagor", cache_dir=None)
    imports = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    assert len(imports) > 100, "the graph is that of the package"
    TopologicalSorter(imports).prepare()  # raises CycleError, which names a circle


@pytest.mark.xdist_group("real time")
@pytest.mark.skipif("PYTEST_XDIST_WORKER" not in os.environ, reason="there is one process only")
def test_tests_in_real_time_are_a_group(request):
    """Versions of pytest and pytest-xdist that do not fit ignore groups, and say nothing."""
    assert request.node.nodeid.endswith("@real time")
