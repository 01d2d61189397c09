"use strict";
// The page of a run or of a recording: its parts, put together from what the server says about it.

const SCALE =
  "Gate, drives and obstacle are to scale, the car is an outline. A drive's force is that of its spindle, positive " +
  "opens; the springs' forces are those of the vehicle file, less what a fault takes away.";
let about; // what the server shows
let charts;
let drawing = null;
let controls = null;

function makeTitle() {
  const name = (file) =>
    file
      .split("/")
      .pop()
      .replace(/\.[^.]*$/, "");
  const titles = {
    run: () =>
      [name(about.vehicle), about.scenario && name(about.scenario), about.starts ? "" : about.channel]
        .filter(Boolean)
        .join(" · "),
    recording: () => about.file.split("/").pop(),
    none: () => "liftgate-hil",
  };
  find("title").textContent = titles[about.kind]();
  document.title = `${find("title").textContent} – liftgate-hil`;
}

async function start() {
  const response = await fetch(path("/api/about"));
  about = await response.json();
  if (!response.ok) {
    find("phase").textContent = about.issues.join("; ");
    return;
  }
  about.geometry = await (await fetch(path("/api/geometry"))).json();
  const isRun = about.kind === "run",
    isOpen = isRun && !about.read_only;
  makeTitle();
  const header = document.querySelector("header"); // which stays at the top: nothing is scrolled below it
  new ResizeObserver(() => {
    document.documentElement.style.scrollPaddingTop = `${header.offsetHeight + 6}px`;
  }).observe(header);
  document.body.classList.add(about.kind);
  charts = new Charts(find("plots"), about, limitsOfForce(), {
    zoomed: ([low, high]) => zoomTo(low, high),
    pointed: (time) => {
      const words = time === null ? "" : `cursor at ${time.toFixed(3)} s`;
      if (find("cursor").textContent !== words) find("cursor").textContent = words;
    },
    shown: (name) => last && columnIn(last, name),
    seek: about.kind === "recording" ? seek : null,
  });
  makeGauge();
  await load();
  const byForm = (content) => {
    if (content.clear === "all" || "hand_force_n" in (content.set || {})) drawing?.handles.drop();
    return command(content);
  };
  if (isOpen) controls = new Controls(about.commands, byForm, about.geometry.open_angle_deg);
  else find("commands").hidden = true;
  const act = isOpen
    ? {
        hand: (newtons) => command({ set: { hand_force_n: newtons } }),
        put: (changed) => controls.put(changed),
        remove: () => command({ clear: "obstacle" }),
      }
    : null;
  if (about.geometry.length_m) drawing = new Drawing(find("drawing"), about.geometry, act);
  find("scene").hidden = !drawing;
  document.querySelector("main").className = drawing || about.kind !== "recording" ? "" : "charts-only";
  find("scene-help").textContent = act
    ? `Drag the green hand to push or pull the gate, and the obstacle into its way; or focus one of them and use the arrow keys. ${SCALE}`
    : SCALE;
  find("stimuli").append(...(about.stimuli || []).map((each) => element("li", {}, each)));
  find("scenario").hidden = !(about.stimuli || []).length;
  find("readonly").hidden = !about.read_only;
  find("hold").hidden = find("window").hidden = !isRun;
  find("controls").hidden = about.kind === "recording" || (isRun && about.read_only);
  document.body.classList.toggle("read-only", isRun && about.read_only);
  find("reports").hidden = !isRun;
  find("charts").hidden = about.kind === "none";
  find("bus-view").hidden = find("trace-view").hidden = !isRun;
  find("values").hidden = about.kind === "none";
  for (const id of ["values", "bus-view"])
    find(id).addEventListener("toggle", () => {
      if (last) show(last);
    });
  makeView();
  if (isRun) makeTrace();
  if (about.starts && !about.read_only) makeStart();
  find("start-help").hidden = isRun;
  if (about.kind === "recording") {
    makeReplay();
    charts.zoom(about.begin_s, about.end_s);
    about.before = (await ask(`/api/state?time=${about.begin_s}`))?.loop; // what was counted before the recording
    const peak = (about.contacts || []).reduce(
      (most, each) => (most && most.peak_n > each.peak_n ? most : each),
      null,
    );
    await seek(peak ? peak.peak_s : about.begin_s);
  } else {
    show(await (await fetch(path("/api/state"))).json());
    if (!hasEnded) hold(false);
    connect();
  }
  document.body.dataset.ready = "yes";
}
start();
