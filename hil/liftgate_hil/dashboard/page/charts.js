"use strict";
// Charts over one time axis. Of each column they draw what was lowest and highest in each stretch, so that no peak is lost.

const CHART_HEIGHT = 128, // where the page has one column
  LEAST_HEIGHT = 84,
  MOST_HEIGHT = 220;
const isBeside = matchMedia("(min-width: 1200px)"); // where page.css has the gate beside its charts
const AXIS_WIDTH = 54,
  AXIS_HEIGHT = 26; // of the time axis below the last chart
const TOUCH_N = 1, // pinch force above which there is a contact, as in a recording
  AROUND_S = 0.3; // that is shown around a contact, at least
// Columns of a panel by quantity, and the least that its axis shows.
const PANELS = [
  { title: "Gate angle", least: 5, names: ["gate_angle_deg", "sensed_gate_angle_deg"] },
  {
    title: "Motor current",
    least: 2,
    names: ["left_current_a", "right_current_a", "sensed_left_current_a", "sensed_right_current_a"],
  },
  { title: "Pinch and hand force", least: 10, names: ["pinch_force_n", "hand_force_n"] },
  { title: "Terminal voltage", least: 1, names: ["terminal_voltage_v", "sensed_terminal_voltage_v"] },
];
// Colours and dashes of Okabe and Ito, by what a column is: the wide line under the narrow one shows that there are two.
const LOOKS = {
  left: ["--left", [], 3],
  right: ["--right", [7, 4], 1.6],
  other: ["--fg", [], 1.8],
  hand: ["--hand", [6, 3], 1.8],
  third: ["--rod", [2, 3], 1.8],
  fourth: ["--ok", [9, 3, 2, 3], 1.8],
};

function looksOf(name, place, count) {
  const isSensed = name.startsWith("sensed_"),
    plain = name.replace(/^sensed_/, "");
  const side = /(^|[._])left/i.test(plain)
    ? "left"
    : /(^|[._])right/i.test(plain)
      ? "right"
      : plain.startsWith("hand_")
        ? "hand"
        : "";
  const [color, dash, width] =
    LOOKS[side || (isSensed ? "third" : ["other", "left", "right", "fourth"][count > 1 ? place % 4 : 0])];
  return { color, dash: isSensed ? [2, 3] : dash, width: isSensed ? 1.2 : width };
}

class Charts {
  // `columns` are those of the source, with their `units`; `ours` maps our names to those of a bus log; `limits` are those of the pinch force.
  constructor(box, { columns, units, ours = {} }, limits, hooks) {
    this.box = box;
    this.columns = columns;
    this.units = units;
    this.ours = ours;
    this.limits = limits;
    this.hooks = hooks;
    this.times = [];
    this.low = {};
    this.high = {};
    this.hidden = new Set();
    this.more = [];
    this.charts = [];
    this.now = null;
    this.range = [0, 1];
    this.make();
    new ResizeObserver(() => requestAnimationFrame(() => this.resize())).observe(box);
    addEventListener("resize", () => this.resize());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      this.make();
      this.draw();
    });
  }

  panels() {
    const known = new Set(this.columns),
      here = (name) => this.ours[name] || name;
    let found = PANELS.map((panel) => ({
      ...panel,
      names: [...new Set(panel.names.map(here))].filter((name) => known.has(name)),
    })).filter((panel) => panel.names.length);
    if (!found.length)
      found = this.columns.slice(1, 5).map((name) => ({ title: name, least: 0, names: [name] }));
    return this.more.length ? [...found, { title: "Chosen", least: 0, names: this.more }] : found;
  }

  // Every column that is drawn.
  get drawn() {
    return [...new Set(this.panels().flatMap((panel) => panel.names))];
  }

  make() {
    for (const { plot } of this.charts) plot.destroy();
    const panels = this.panels();
    this.charts = panels.map((panel, k) => this.chart(panel, k === panels.length - 1));
    this.box.replaceChildren(...this.charts.map((each) => each.holder));
    this.resize();
  }

  chart({ title, names, least }, isLast) {
    const style = getComputedStyle(document.documentElement),
      colour = (name) => style.getPropertyValue(name).trim();
    const holder = element("div", {}),
      bar = element("div", { className: "panel" }),
      unit = this.units[names[0]];
    bar.append(element("b", {}, unit ? `${title} [${unit}]` : title));
    const series = [{}],
      bands = [],
      values = [];
    names.forEach((name, k) => {
      const look = looksOf(name, k, names.length),
        stroke = colour(look.color),
        shown = !this.hidden.has(name);
      for (let twice = 0; twice < 2; twice += 1)
        series.push({ stroke, width: look.width, dash: look.dash, show: shown, points: { show: false } });
      bands.push({ series: [2 * k + 1, 2 * k + 2], fill: stroke + "40" });
      const value = element("span", {}, "–"),
        sample = shape("svg", { viewBox: "0 0 26 8", "aria-hidden": "true" });
      shape(
        "path",
        { d: "M0 4H26", stroke, "stroke-width": look.width, "stroke-dasharray": look.dash.join(" ") },
        sample,
      );
      const button = element(
        "button",
        { type: "button", title: `show or hide ${name}` },
        sample,
        this.called(name, names),
        value,
      );
      button.setAttribute("aria-pressed", String(shown));
      button.onclick = () => {
        if (this.hidden.has(name)) this.hidden.delete(name);
        else this.hidden.add(name);
        this.make();
        this.draw();
      };
      bar.append(button);
      values.push(value);
    });
    const canvas = element("div", {});
    holder.append(bar, canvas);
    const dim = colour("--dim"),
      line = colour("--line"),
      axis = { stroke: dim, grid: { stroke: line, width: 1 }, ticks: { stroke: line } };
    const plot = new uPlot(
      {
        width: 300,
        height: CHART_HEIGHT + (isLast ? AXIS_HEIGHT : 0),
        series,
        bands,
        padding: [6, 14, isLast ? 0 : 6, 0],
        legend: { show: false },
        scales: { x: { time: false, range: () => this.range }, y: { range: rangeOf(least, this.limitsOf(names)) } },
        axes: [
          {
            ...axis,
            show: isLast,
            size: 30,
            label: isLast ? "time [s]" : undefined,
            labelSize: isLast ? 16 : 0,
          },
          { ...axis, size: AXIS_WIDTH },
        ],
        cursor: {
          sync: {
            key: "time",
            scales: ["x", null],
            filters: { sub: (kind) => kind === "mousemove" || kind === "mouseleave" },
          },
          drag: { x: true, y: false, setScale: false },
          focus: { prox: -1 },
        },
        hooks: {
          setSelect: [(it) => this.select(it)],
          setCursor: [() => this.showValues()],
          draw: [(it) => this.drawLimits(it, this.limitsOf(names)), (it) => this.drawNow(it)],
        },
      },
      [[], ...names.flatMap(() => [[], []])],
      canvas,
    );
    plot.over.addEventListener("click", () => {
      if (plot.cursor.left >= 0 && this.hooks.seek) this.hooks.seek(plot.posToVal(plot.cursor.left, "x"));
    });
    return { plot, names, holder, values };
  }

  // A column in its panel, without what all of it have in common; a signal of a bus log by its own name.
  called(name, names) {
    if (Object.values(this.ours).includes(name)) return name;
    const words = [
      /(^|[._])left/i.test(name) && "left",
      /(^|[._])right/i.test(name) && "right",
      name.startsWith("sensed_") && "sensed",
    ].filter(Boolean);
    if (names.length === 1 || name === "hand_force_n" || name === "pinch_force_n" || this.more === names)
      return name === "pinch_force_n"
        ? "pinch"
        : name === "hand_force_n"
          ? "hand"
          : names.length === 1
            ? ""
            : name;
    return words.join(" ") || "true";
  }

  get pinch() {
    return this.ours.pinch_force_n || "pinch_force_n";
  }

  limitsOf(names) {
    return names.includes(this.pinch) ? this.limits : [];
  }

  // Beside the gate the charts share the height of the window, so that all of them are in sight.
  resize() {
    const width = this.box.clientWidth - 10,
      last = this.charts.length - 1;
    if (width < 50) return;
    const { top, height } = this.box.getBoundingClientRect(),
      drawn = this.charts.reduce((sum, { plot }) => sum + plot.height, 0),
      free = innerHeight - (top + scrollY) - (height - drawn) - AXIS_HEIGHT - 8;
    const each = isBeside.matches
      ? Math.floor(within(free / this.charts.length, LEAST_HEIGHT, MOST_HEIGHT))
      : CHART_HEIGHT;
    this.charts.forEach(({ plot }, k) => {
      const wanted = each + (k === last ? AXIS_HEIGHT : 0);
      if (plot.width !== width || plot.height !== wanted) plot.setSize({ width, height: wanted });
    });
  }

  // What was selected in one chart is shown in all: the same two times in each.
  select(plot) {
    const { left, width } = plot.select;
    if (width < 3) return;
    const range = [plot.posToVal(left, "x"), plot.posToVal(left + width, "x")];
    for (const each of this.charts) each.plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    this.hooks.zoomed(range);
  }

  zoom(low, high) {
    this.range = [low, high > low ? high : low + 1e-3];
    this.draw();
  }

  draw() {
    for (const { plot, names } of this.charts) {
      plot.setData(
        [this.times, ...names.flatMap((name) => [this.high[name] || [], this.low[name] || []])],
        false,
      );
      plot.setScale("x", { min: this.range[0], max: this.range[1] });
    }
    this.showValues();
  }

  drawLimits(plot, limits) {
    const { ctx, bbox } = plot,
      style = getComputedStyle(document.documentElement),
      pixel = devicePixelRatio;
    ctx.save();
    ctx.strokeStyle = ctx.fillStyle = style.getPropertyValue("--bad");
    ctx.font = `${11 * pixel}px system-ui, sans-serif`;
    ctx.textAlign = "left";
    ctx.textBaseline = "alphabetic";
    for (const limit of limits) {
      const y = plot.valToPos(limit.force_n, "y", true);
      if (y < bbox.top || y > bbox.top + bbox.height) continue;
      ctx.setLineDash(limit.longest_s === 0 ? [] : [5 * pixel, 4 * pixel]);
      ctx.beginPath();
      ctx.moveTo(bbox.left, y);
      ctx.lineTo(bbox.left + bbox.width, y);
      ctx.stroke();
      ctx.fillText(limit.words, bbox.left + 4 * pixel, y + (y > bbox.top + 14 * pixel ? -3 : 11) * pixel);
    }
    ctx.restore();
  }

  drawNow(plot) {
    if (this.now === null) return;
    const x = plot.valToPos(this.now, "x", true),
      { ctx, bbox } = plot;
    if (x < bbox.left || x > bbox.left + bbox.width) return;
    ctx.save();
    ctx.strokeStyle = getComputedStyle(document.documentElement).getPropertyValue("--accent");
    ctx.lineWidth = 2;
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
    ctx.restore();
  }

  // Values at the cursor, else those of the state that the page shows, as in its header.
  showValues() {
    const cursor = this.charts
      .map(({ plot }) => plot.cursor.idx)
      .find((each) => each !== null && each !== undefined);
    for (const { names, values } of this.charts)
      names.forEach((name, k) => {
        const [low, high] =
          cursor === undefined
            ? Array(2).fill(this.hooks.shown(name))
            : [this.low[name]?.[cursor], this.high[name]?.[cursor]];
        const words = valueText(low, high);
        if (values[k].textContent !== words) values[k].textContent = words;
      });
    this.hooks.pointed(cursor === undefined ? null : this.times[cursor]);
  }

  // The contact with the largest pinch force that is drawn: begin, end, peak and step between two points [s]; null: there is none.
  largestContact() {
    const force = this.high[this.pinch] || [];
    let peak = -1;
    force.forEach((each, k) => {
      if (each > TOUCH_N && (peak < 0 || each > force[peak])) peak = k;
    });
    if (peak < 0) return null;
    let first = peak,
      last = peak;
    while (force[first - 1] > TOUCH_N) first -= 1;
    while (force[last + 1] > TOUCH_N) last += 1;
    const [begin_s, end_s, peak_s] = [first, last, peak].map((k) => this.times[k]),
      step_s = peak_s - (this.times[peak - 1] ?? peak_s);
    return { begin_s, end_s, peak_s, step_s };
  }

  take(plot) {
    this.times = plot.time_s;
    this.low = { ...plot.low };
    this.high = { ...plot.high };
  }

  // Add a stretch that ends at a time; what is older than `history` seconds is dropped now and then.
  append(time, span, history) {
    const end = this.times[this.times.length - 1];
    if (this.times.length && time <= end) return;
    this.times.push(time);
    for (const name of this.drawn) {
      const place = this.columns.indexOf(name);
      for (const [kept, given] of [
        [this.low, span.low],
        [this.high, span.high],
      ]) {
        kept[name] ??= new Array(this.times.length - 1).fill(null);
        kept[name].push(given[place]);
      }
    }
    const first = this.times.findIndex((each) => each >= time - history);
    if (first > 600) {
      this.times.splice(0, first);
      for (const kept of [this.low, this.high])
        for (const name of Object.keys(kept)) kept[name].splice(0, first);
    }
  }
}

// From the lowest to the highest, but for as much as `least` at least; a limit is in sight from half of it on.
function rangeOf(least, limits) {
  return (plot, low, high) => {
    if (low === null) return [0, least || 1];
    const seen = limits.map(({ force_n: limit }) => limit).filter((limit) => high > limit / 2);
    high = Math.max(high, ...seen.map((limit) => 1.1 * limit));
    const middle = (low + high) / 2,
      half = (Math.max(high - low, least || 1e-9) / 2) * 1.08;
    return [middle - half, middle + half];
  };
}

function valueText(low, high) {
  if (typeof low !== "number" || typeof high !== "number") return "–";
  const brief = (value) => text(value, Math.abs(value) < 10 ? 3 : 2);
  return high - low > 0.02 * Math.max(Math.abs(high), Math.abs(low), 1)
    ? `${brief(low)} to ${brief(high)}`
    : brief(high);
}

// The times to show around a contact, with some points before and after it.
function around({ begin_s: begin, end_s: end, step_s: step = 0 }) {
  const more = Math.max(AROUND_S, end - begin, 5 * step);
  return [begin - more, end + more];
}
