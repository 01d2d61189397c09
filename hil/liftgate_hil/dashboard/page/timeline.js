"use strict";
// The time axis of the charts, and a recording that is played along it.

const POINTS = 2000; // of a curve
let isHeld = false; // the charts stand still
let followed = "20"; // seconds of a run that are drawn while its charts go on, as their list has it

function follow() {
  const end = charts.times.length ? charts.times[charts.times.length - 1] : 1,
    width = +find("window").value;
  charts.zoom(Math.max(0, end - width), Math.max(end, width));
}

// Of a run: the charts stand still, or go on.
function hold(on) {
  isHeld = on;
  find("hold").textContent = on ? "Resume charts" : "Pause charts";
  if (on || about.kind !== "run") return;
  find("window").value = followed;
  follow();
}

async function load(low = -Infinity, high = Infinity) {
  const asked = [
    `columns=${charts.drawn.join(",")}`,
    `points=${POINTS}`,
    ...(Number.isFinite(low) ? [`from=${low}`, `to=${high}`] : []),
  ];
  const found = await ask(`/api/plot?${asked.join("&")}`);
  if (found) charts.take(found);
}

let loading = null;
function zoomTo(low, high) {
  if (about.kind === "recording") {
    const least = (about.end_s - about.begin_s) * 1e-5,
      wide = within(high - low, least, about.end_s - about.begin_s);
    low = within(low, about.begin_s, about.end_s - wide);
    high = low + wide;
    clearTimeout(loading);
    loading = setTimeout(async () => {
      await load(low, high);
      charts.draw();
    }, 120);
  } else {
    hold(true);
    find("window").value = ""; // zoomed
  }
  charts.zoom(low, high);
}

function makeView() {
  const about_ = (factor, shift = 0) => {
    const [low, high] = charts.range,
      half = (high - low) / 2,
      middle = (low + high) / 2 + shift * half;
    zoomTo(middle - factor * half, middle + factor * half);
  };
  find("zoom-in").onclick = () => about_(0.5);
  find("zoom-out").onclick = () => about_(2);
  find("earlier").onclick = () => about_(1, -0.5);
  find("later").onclick = () => about_(1, 0.5);
  find("whole").onclick = () => {
    if (about.kind === "recording") zoomTo(about.begin_s, about.end_s);
    else if (charts.times.length) zoomTo(charts.times[0], charts.times.at(-1));
  };
  find("hold").onclick = () => hold(!isHeld);
  find("window").onchange = () => {
    followed = find("window").value;
    hold(false);
  };
}

function point(time) {
  find("seek").value = time;
  charts.now = time;
  for (const { plot } of charts.charts) plot.redraw(false);
}

async function seek(time) {
  if (wire && wire.readyState === 1) {
    wire.send(JSON.stringify({ time_s: time }));
    return;
  }
  point(time);
  const state = await ask(`/api/state?time=${time}`);
  if (state) show(state);
}

function stop() {
  find("play").textContent = "Play";
  if (wire) {
    wire.onclose = null;
    wire.close();
    wire = null;
  }
}

function makeReplay() {
  const bar = find("seek"),
    play = find("play");
  find("replay").hidden = false;
  bar.min = about.begin_s;
  bar.max = about.end_s;
  bar.value = about.end_s;
  bar.addEventListener("input", () => seek(+bar.value));
  const speed = () => ({ speed: +find("speed").value });
  find("speed").onchange = () => {
    if (wire && wire.readyState === 1) wire.send(JSON.stringify(speed()));
  };
  play.onclick = () => {
    if (wire) {
      stop();
      return;
    }
    if (isGone) {
      answer("no connection to the server", true);
      return;
    }
    const begin = +bar.value >= about.end_s - 1e-9 ? about.begin_s : +bar.value;
    connect();
    wire.addEventListener("open", () => wire.send(JSON.stringify({ time_s: begin, ...speed() })));
    play.textContent = "Pause";
  };
  const contacts = (about.contacts || []).map((each) =>
    element(
      "button",
      {
        type: "button",
        onclick: () => {
          stop();
          zoomTo(...around(each));
          seek(each.peak_s);
        },
      },
      `pinch ${text(each.peak_n, 0)} N at ${text(each.peak_s, 2)} s`,
    ),
  );
  const marks = about.marks.map((each) =>
    element(
      "button",
      {
        type: "button",
        onclick: () => {
          stop();
          seek(each.time_s);
        },
      },
      `${each.text} at ${text(each.time_s, 2)} s`,
    ),
  );
  find("contacts").append(
    ...(contacts.length
      ? ["Contacts:", ...contacts]
      : [about.contacts ? "No contact in this recording." : "The recording holds no pinch force."]),
    ...(marks.length ? [" Marks:", ...marks] : []),
    ...(about.geometry.length_m ? [] : [" The gate is drawn if --vehicle names its vehicle."]),
  );
}
