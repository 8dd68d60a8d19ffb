"""A task with published data, as small as one can be: each file asks for a number, and holds the answer."""

from pathlib import Path

from eagor.lab.tasks.published import PublishedConfig, PublishedTask, score_metric
from eagor.lab.tasks.task import Sample


class NumbersConfig(PublishedConfig, kw_only=True):
    faults: dict = {}  # noqa: RUF012 (of a record, for tests)


class Numbers(PublishedTask):
    name, title, what = "numbers", "Numbers", "say the number"
    agents = {"right": "says what the file says"}  # noqa: RUF012
    Config = NumbersConfig
    metrics = (score_metric("overall", "Overall", "share of right answers", lambda record: record["score"]),)

    def info(self, data):
        return {"files": len(list(Path(data).glob("*.txt")))}

    def samples(self, config):
        files = sorted(Path(config.data).glob("*.txt"))
        return [Sample(file.stem, file.stem[0], file.read_text()) for file in files]

    def runner(self, config):
        return lambda payload: {"case": payload, "cluster": payload[0], "score": 1.0} | config.faults

    def score(self, sample, prediction, config):
        return {"case": sample.id, "cluster": sample.group, "score": float(prediction["text"] == sample.payload)}


def write(folder):
    for name in ("a1", "a2", "b1"):
        (folder / f"{name}.txt").write_text(name)
    return folder
