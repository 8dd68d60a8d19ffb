"""A benchmark with published data, as small as one can be: each file asks for a number, and holds the answer."""

from pathlib import Path

from eagor.lab.tasks.benchmark import Case, Figure


class Numbers:
    name = "numbers"
    title = "Numbers"
    agents = {"right": "says what the file says"}  # noqa: RUF012
    options = {}  # noqa: RUF012
    work = "small_benchmark:work"
    figures = (Figure("overall", "Overall", "share of right answers", lambda record: record["score"]),)

    def info(self, data):
        return {"files": len(list(Path(data).glob("*.txt")))}

    def cases(self, data, settings):
        return [Case(file.stem, file.stem, file.stem[0], file.read_text()) for file in sorted(Path(data).glob("*.txt"))]

    def settle(self, settings):
        return {key: settings[key] for key in ("task", "data", "agent", "seed")}

    def judge(self, case, prediction, settings):
        return {"case": case.id, "cluster": case.cluster, "score": float(prediction["text"] == case.payload)}


def write(folder):
    for name in ("a1", "a2", "b1"):
        (folder / f"{name}.txt").write_text(name)
    return folder


def work(settings):
    """The record of a case, with whatever faults the settings ask for."""
    faults = settings.get("faults", {})
    return lambda payload: {"case": payload, "cluster": payload[0], "score": 1.0} | faults
