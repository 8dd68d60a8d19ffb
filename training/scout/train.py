"""Train the scout.

    python train.py FOLDER --out RUN --minutes 180 --threads 2

FOLDER holds the splits of `data.py`. RUN gets ``state.pt`` (everything that is needed to go on; the same command goes
on where it was stopped), ``best.pt`` (the averaged weights with the best validation), ``last.pt`` (those of the last
step, once it is through) and ``log.jsonl``.

The recipe: batches of 8 views with 12 queries each, half of them about things in view; AdamW, the rate warmed up and
then lowered along a cosine over `--steps` or `--minutes`, whichever ends first; weights averaged (EMA). The loss is the
sum of a focal cross-entropy per cell against Gaussian targets (quality focal loss, Li et al. 2020), weighted by solid
angle; the cross-entropy between target and response as distributions over the sphere; the cross-entropy of
presence; and, for the trunk alone, of what class and what colour each cell shows.
"""

from __future__ import annotations

import argparse
import copy
import json
import math
import queue
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from balls import SHARE
from evaluate import Respond, figures, rows_of
from model import Scout
from samples import CLASSES, NO_COLOUR, UNSURE, WORDS, Apartment, Batch, draw, read_split
from torch import Tensor
from torch.nn import functional as F

WARM = 150  # steps
BACKGROUND = 0.25  # weight of a cell of wall, floor or ceiling where classes are told apart
SCALE = 10.0  # cells that a target covers, about: keeps the loss per cell near 1


def network() -> Scout:
    """A fresh scout for the built-in world."""
    return Scout(len(WORDS), NO_COLOUR, len(CLASSES)).to(memory_format=torch.channels_last)  # type: ignore[call-overload]


def loss_of(model: Scout, batch: Batch, half: bool) -> tuple[Tensor, dict[str, float]]:
    """The loss of a batch, and its parts."""
    image = torch.from_numpy(batch.image).contiguous(memory_format=torch.channels_last)
    heat, present = torch.from_numpy(batch.heat), torch.from_numpy(batch.present)
    with torch.autocast("cpu", torch.bfloat16, enabled=half):
        features = model.trunk(image)
        logits, presence = model.answer(features, torch.from_numpy(batch.words))
        shown, tint = model.classes(features).float(), model.tints(features).float()
    area = model.area
    likely = torch.sigmoid(logits)
    cells = F.binary_cross_entropy_with_logits(logits, heat, reduction="none") * (likely.detach() - heat).abs() ** 1.5
    parts = {"heat": (cells * area).sum(dim=(2, 3)).mean() / SCALE * 4}
    wanted = (heat * area).flatten(2)
    mass = wanted.sum(dim=2, keepdim=True)
    log_share = torch.log_softmax((logits + torch.log(area)).flatten(2), dim=2)
    cross = -(wanted / mass.clamp(min=1e-6) * log_share).sum(dim=2)
    parts["where"] = 0.25 * (cross * present).sum() / present.sum().clamp(min=1)
    parts["presence"] = 0.5 * F.binary_cross_entropy_with_logits(presence, present)
    weight = area[:, 0].expand(shown.shape[0], -1, shown.shape[3])
    classes = F.cross_entropy(shown, torch.from_numpy(batch.shown).long(), reduction="none")
    # Walls, floors and ceilings fill most of a picture and are easy to tell.
    telling = torch.where(torch.from_numpy(batch.shown) < len(WORDS), weight, BACKGROUND * weight)
    parts["class"] = (classes * telling).sum() / telling.sum()
    hue = torch.from_numpy(batch.tint).long()
    hues = F.cross_entropy(tint, hue, ignore_index=UNSURE, reduction="none")
    known = weight * (hue != UNSURE)
    parts["tint"] = 0.25 * (hues * known).sum() / known.sum().clamp(min=1)
    return torch.stack(list(parts.values())).sum(), {key: float(value.detach()) for key, value in parts.items()}


def torch_respond(model: Scout) -> Respond:
    """The responses of a model in training."""
    model.eval()

    def respond(image: np.ndarray, words: np.ndarray) -> np.ndarray:
        with torch.inference_mode():
            picture = torch.from_numpy(image).permute(2, 0, 1)[None].float() / 255
            heat, presence = model(picture.contiguous(memory_format=torch.channels_last), torch.from_numpy(words)[None])
            return (torch.sigmoid(heat) * torch.sigmoid(presence)[..., None, None])[0].numpy()

    return respond


def batches(apartments: list[Apartment], size: int, queries: int, seed: int, start: int) -> Iterator[Batch]:
    """Batches without end, made ahead by a thread; batch k depends on `seed` and k alone."""
    made: queue.Queue[Batch] = queue.Queue(maxsize=4)

    def work() -> None:
        k = start
        while True:
            made.put(draw(apartments, size, queries, np.random.default_rng([seed, k])))
            k += 1

    threading.Thread(target=work, daemon=True).start()
    while True:
        yield made.get()


def average(ema: Scout, model: Scout, step: int, decay: float) -> None:
    """Move the averaged weights and statistics towards those of `model`."""
    keep = min(decay, (1 + step) / (10 + step))
    with torch.no_grad():
        for mine, its in zip(ema.state_dict().values(), model.state_dict().values(), strict=True):
            if mine.dtype.is_floating_point:
                mine.lerp_(its, 1 - keep)
            else:
                mine.copy_(its)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description="Train the scout.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=40_000)
    parser.add_argument("--minutes", type=float, default=math.inf, help="of training, all runs together")
    parser.add_argument("--stop-after", type=float, default=math.inf, help="minutes of this run, then save and leave")
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--queries", type=int, default=12)
    parser.add_argument("--rate", type=float, default=2e-3)
    parser.add_argument("--decay", type=float, default=0.998, help="of the averaged weights")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--half", action=argparse.BooleanOptionalAction, default=True, help="bfloat16 where it pays")
    parser.add_argument("--check-every", type=float, default=10, help="minutes between validations")
    parser.add_argument("--apartments", type=int)
    parser.add_argument("--from-weights", type=Path, help="begin with these weights (best.pt of another run)")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(given.threads)
    torch.manual_seed(given.seed)
    train = read_split(given.folder / "train", given.apartments, SHARE)
    validation = read_split(given.folder / "validation")
    model = network()
    if given.from_weights:
        model.load_state_dict(torch.load(given.from_weights, weights_only=True), strict=False)  # new layers start anew
    ema = copy.deepcopy(model)
    decayed = [p for p in model.parameters() if p.ndim > 1]
    others = [p for p in model.parameters() if p.ndim <= 1]
    groups = [{"params": decayed, "weight_decay": 0.02}, {"params": others, "weight_decay": 0.0}]
    optimiser = torch.optim.AdamW(groups, lr=given.rate, betas=(0.9, 0.98))
    step, elapsed, best = 0, 0.0, -math.inf
    file = given.out / "state.pt"
    if file.exists():
        state = torch.load(file, weights_only=True)
        model.load_state_dict(state["model"])
        ema.load_state_dict(state["ema"])
        optimiser.load_state_dict(state["optimiser"])
        step, elapsed, best = state["step"], state["elapsed"], state["best"]

    def save(name: Path, what: object) -> None:
        part = name.with_suffix(".part")
        torch.save(what, part)
        part.replace(name)

    def check() -> None:
        nonlocal best
        found = figures(rows_of(validation, torch_respond(ema)))
        log.write(json.dumps({"step": step, "minutes": round(elapsed / 60, 2), "validation": found}) + "\n")
        log.flush()
        worth = found["inside"] + found["auc"]
        if worth > best:
            best = worth
            save(given.out / "best.pt", ema.state_dict())
        now = {"model": model.state_dict(), "ema": ema.state_dict(), "optimiser": optimiser.state_dict()}
        save(file, now | {"step": step, "elapsed": elapsed, "best": best})

    began = last = checked = time.monotonic()
    sums: dict[str, float] = {}
    with (given.out / "log.jsonl").open("a", encoding="utf-8") as log:
        for batch in batches(train, given.batch, given.queries, given.seed, step):
            progress = max(step / given.steps, elapsed / 60 / given.minutes)
            if progress >= 1 or time.monotonic() - began > 60 * given.stop_after:
                break
            rate = given.rate * min(1, (step + 1) / WARM) * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * progress)))
            for group in optimiser.param_groups:
                group["lr"] = rate
            model.train()
            loss, parts = loss_of(model, batch, given.half)
            optimiser.zero_grad(set_to_none=True)
            loss.backward()
            torch.nn.utils.clip_grad_norm_(model.parameters(), 5.0)
            optimiser.step()
            step += 1
            average(ema, model, step, given.decay)
            now = time.monotonic()
            elapsed, last = elapsed + min(now - last, 10.0), now  # a suspended machine does not train
            for key, value in parts.items():
                sums[key] = sums.get(key, 0.0) + value / 100
            if step % 100 == 0:
                line = {"step": step, "minutes": round(elapsed / 60, 2), "rate": rate}
                log.write(json.dumps(line | {key: round(value, 4) for key, value in sums.items()}) + "\n")
                log.flush()
                sums = {}
            if now - checked > 60 * given.check_every:
                check()
                last = checked = time.monotonic()
        check()
    if progress >= 1:
        save(given.out / "last.pt", ema.state_dict())


if __name__ == "__main__":
    main()
