"use strict";
// The bus of a run: its figures, the last frame of each message, and its trace.

const TRACE_MS = 500, // between two questions for frames
  KEPT_FRAMES = 5000, // of the trace, here
  SHOWN_FRAMES = 200; // of those that match the filter

// The signals of a frame in words, with their units.
function signalsOf({ name, signals }) {
  const unit = (signal) => about.signal_units?.[`${name}.${signal}`] || "";
  return Object.entries(signals)
    .map(([signal, value]) =>
      `${signal} = ${text(value, 3)} ${typeof value === "number" ? unit(signal) : ""}`.trim(),
    )
    .join(",  ");
}

function showBus(state) {
  const bus = state.bus || {},
    loop = state.loop || {},
    late = loop.lateness_us,
    spread = (of) => of && [of.p50_us, of.p99_us, of.max_us].map((each) => text(each, 1)).join(", ");
  const figures = [
    ["channel", bus.channel],
    ["bus load [%]", bus.load_percent],
    ["frames sent", bus.sent],
    ["frames received", bus.received],
    ["commands accepted", bus.accepted],
    ["rejected (length, range, checksum, counter)", bus.rejected],
    ["foreign (unknown identifiers)", bus.foreign],
    ["not sent", bus.unsent],
    ["dropped by the system", bus.dropped],
    ["clock", loop.clock],
    ["rate [Hz]", loop.rate_hz],
    ["ticks missed", loop.ticks_missed],
    ["lateness p50, p99, max [µs]", spread(late)],
    ["command to feedback p50, p99, max [µs]", spread(loop.command_delay_us)],
  ];
  rows(
    find("bus"),
    figures.filter(([, value]) => value !== undefined && value !== null),
  );
}

function showMessages(messages, now) {
  const ages = messages.map((each) => now - each.time_s);
  rows(
    find("messages"),
    messages.map((each, k) => [
      each.id,
      each.name,
      each.direction,
      each.count,
      each.cycle_ms === null ? "" : `${text(each.cycle_ms, 1)} ms`,
      ages[k] < 1 ? "now" : `${ages[k].toFixed(0)} s ago`,
      each.data,
      signalsOf(each),
    ]),
  );
  [...find("messages").tBodies[0].rows].forEach((row, k) => {
    row.className = ages[k] > Math.max(0.5, 3e-3 * (messages[k].cycle_ms || 0)) ? "stale" : "";
  });
}

// Every frame in its order. The server is asked only while the trace is open and not held.
const trace = {
  frames: [],
  last: 0, // number of the last frame that came
  missed: 0,
  isHeld: false,
  isAsking: false,

  async ask() {
    if (this.isAsking || this.isHeld || isGone || document.hidden || !find("trace-view").open) return;
    this.isAsking = true;
    const found = await ask(`/api/trace?after=${this.last}`);
    this.isAsking = false;
    if (!found || this.isHeld) return;
    if (this.last) this.missed += found.first - this.last - 1;
    this.last = found.first + found.frames.length - 1;
    this.frames = [...this.frames, ...found.frames].slice(-KEPT_FRAMES);
    this.show();
  },

  hold(on) {
    this.isHeld = on;
    find("trace-hold").textContent = on ? "Resume trace" : "Pause trace";
    if (!on) this.ask();
  },

  clear() {
    this.frames = [];
    this.missed = 0;
    this.show();
  },

  show() {
    const words = find("trace-filter").value.toLowerCase().split(/\s+/).filter(Boolean),
      heads = ({ id, name, direction }) => [id, name, direction].map((each) => each.toLowerCase()),
      known = new Set(this.frames.flatMap(heads)),
      line = (each) => `${heads(each).join(" ")} ${each.data} ${signalsOf(each).toLowerCase()}`,
      // A word that is the name of a message means that message: "gate" is not GateAcceleration.
      has = (each, word) => (known.has(word) ? heads(each).includes(word) : line(each).includes(word)),
      matching = words.length
        ? this.frames.filter((each) => words.every((word) => has(each, word)))
        : this.frames;
    const shown = matching.slice(-SHOWN_FRAMES).reverse();
    rows(
      find("trace"),
      shown.map((each) => [
        each.time_s.toFixed(4),
        each.id,
        each.name,
        each.direction,
        each.data,
        signalsOf(each),
      ]),
    );
    find("trace-count").textContent = [
      `${matching.length} of ${numberOf(this.frames.length, "frame")}`,
      ...(shown.length < matching.length ? [`the last ${shown.length} are shown`] : []),
      ...(this.missed ? [`${this.missed} came too fast to be kept`] : []),
    ].join(", ");
  },
};

function makeTrace() {
  find("trace-filter").oninput = () => trace.show();
  find("trace-hold").onclick = () => trace.hold(!trace.isHeld);
  find("trace-clear").onclick = () => trace.clear();
  find("trace-view").addEventListener("toggle", () => trace.ask());
  setInterval(() => trace.ask(), TRACE_MS);
}
