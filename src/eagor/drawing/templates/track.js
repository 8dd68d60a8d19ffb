"use strict";
(function () {
  const data = JSON.parse(document.getElementById("steps").textContent);
  const at = (id) => document.getElementById(id);
  const picture = at("picture"), slider = at("slider"), play = at("play"), frame = at("frame"), svg = at("timeline");
  let shown = -1, timer = null;

  function show(index) {
    shown = Math.max(0, Math.min(data.steps.length - 1, index));
    const step = data.steps[shown];
    picture.src = step.picture;
    picture.alt = step.said;
    at("caption").textContent = step.said;
    slider.value = shown;
    slider.setAttribute("aria-valuetext", step.name);
    at("count").textContent = (shown + 1) + " / " + data.steps.length;
    const x = data.left + data.wide * Math.min(1, step.at / data.span);
    at("now").setAttribute("x1", x);
    at("now").setAttribute("x2", x);
    for (const row of document.querySelectorAll("tr.shown")) row.classList.remove("shown");
    const row = at("row" + step.row);
    if (row) row.classList.add("shown");
    if (step.x !== null && frame.scrollWidth > frame.clientWidth)
      frame.scrollLeft = step.x * frame.scrollWidth - frame.clientWidth / 2;
  }

  function stop() {
    clearTimeout(timer);
    timer = null;
    play.textContent = "Play";
  }

  function next() {
    if (shown >= data.steps.length - 1) return stop();
    show(shown + 1);
    const wait = shown + 1 < data.steps.length ? data.steps[shown + 1].at - data.steps[shown].at : 1;
    timer = setTimeout(next, 1000 * Math.max(0.05, Math.min(2, wait)));
  }

  function start() {
    if (shown >= data.steps.length - 1) show(0);
    play.textContent = "Pause";
    timer = setTimeout(next, 300);
  }

  const go = (index) => { stop(); show(index); };
  play.addEventListener("click", () => (timer === null ? start() : stop()));
  at("back").addEventListener("click", () => go(shown - 1));
  at("forth").addEventListener("click", () => go(shown + 1));
  slider.addEventListener("input", () => go(Number(slider.value)));
  document.addEventListener("keydown", (event) => {
    if (event.target.closest("input, button, .scroll") || event.altKey || event.ctrlKey || event.metaKey) return;
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (step) go(shown + step);
    else if (event.key === "Home") go(0);
    else if (event.key === "End") go(data.steps.length - 1);
    else if (event.key === " ") timer === null ? start() : stop();
    else return;
    event.preventDefault();
  });
  svg.addEventListener("click", (event) => {
    const box = svg.getBoundingClientRect();
    const x = ((event.clientX - box.left) / box.width) * data.full;
    const time = ((x - data.left) / data.wide) * data.span;
    let best = 0;
    data.steps.forEach((step, index) => { if (step.at <= time) best = index; });
    go(best);
  });
  for (const button of document.querySelectorAll("button[data-step]"))
    button.addEventListener("click", () => { go(Number(button.dataset.step)); frame.scrollIntoView({ block: "nearest" }); });
  at("player").hidden = false;
  show(data.steps.length - 1);
})();
