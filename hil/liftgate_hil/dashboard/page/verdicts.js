"use strict";
// What is judged: limits of the pinch force, verdicts on the expectations, and the end of a run.

// The limits of the pinch force: those of the scenario's expectations, else the vehicle file's.
function limitsOfForce() {
  const own = (about.force_limits || []).map((limit) => ({
    ...limit,
    words:
      limit.longest_s === 0
        ? `limit ${text(limit.force_n, 0)} N`
        : `over ${text(limit.force_n, 0)} N for ${limit.longest_s === null ? "a time" : `${text(limit.longest_s)} s`}`,
  }));
  const force = about.geometry.pinch_limit_n;
  if (own.length || !force) return own;
  return [{ force_n: force, longest_s: 0, words: `vehicle's limit ${text(force, 0)} N`, expectation: "" }];
}

function isOver(force) {
  return charts.limits.some((limit) => limit.longest_s === 0 && force > limit.force_n);
}

function makeGauge() {
  find("gauge-limits").append(
    ...charts.limits.map(({ longest_s: longest }) =>
      shape("path", { class: longest === 0 ? "limit" : "limit timed" }),
    ),
  );
  find("gauge-text").append(
    ...charts.limits.map(({ words, longest_s: longest, expectation }) =>
      element(
        "span",
        { className: longest === 0 ? "limit" : "limit timed", title: expectation },
        ` ${words}`,
      ),
    ),
  );
}

function showGauge(now, peak, since) {
  const most = charts.limits.map(({ force_n: limit }) => limit),
    full = Math.max(1.3 * Math.max(0, ...most), peak || 0, now || 0) || 100,
    x = (force) => 1 + 198 * within((force || 0) / full, 0, 1);
  find("gauge-now").setAttribute("width", x(now) - 1);
  find("gauge-now").classList.toggle("over", isOver(now));
  find("gauge-peak").setAttribute("d", peak > 0 ? `M${x(peak)} 2V16` : "");
  most.forEach((limit, k) => find("gauge-limits").children[k].setAttribute("d", `M${x(limit)} 1V20`));
  const words = {
    "gauge-force": `Pinch force ${text(now, 0)} N`,
    "gauge-peak-text": peak > 0 ? `last peak ${text(peak, 0)} N${since}` : "",
  };
  for (const [name, each] of Object.entries(words)) {
    if (find(name).textContent !== each) find(name).textContent = each;
  }
}

// The name of an expectation with its formula and, at the end, a reason; made once each.
const named = new Map();
function nameOf(expectation, reason) {
  const below = [about.expectations?.[expectation], reason].filter(Boolean),
    key = [expectation, ...below].join("\n");
  if (!below.length) return expectation;
  if (!named.has(key))
    named.set(
      key,
      element("div", {}, expectation, ...below.map((each) => element("div", { className: "meaning" }, each))),
    );
  return named.get(key);
}

// Shows verdicts, with their reasons but for the one that the headline states.
function showVerdicts(verdicts, stated = "") {
  if (!verdicts || !verdicts.length) return;
  find("verdicts").hidden = false;
  const table = find("verdicts").querySelector("table");
  rows(
    table,
    verdicts.map((each) => [
      nameOf(each.name, each.reason === stated ? "" : plain(each.reason)),
      each.verdict,
      each.margin_text,
      each.times_text.replace(/at | (?=s)/g, (found) => found.replace(" ", "\u00a0")), // breaks between two times only
    ]),
  );
  [...table.tBodies[0].rows].forEach((row, k) => {
    row.cells[1].className = verdicts[k].verdict;
  });
}

// A text of the server without the marks of names in it.
const plain = (words) => (words || "").replaceAll("`", "");

// Why a run has ended as it has: the first cause, with the name of the expectation if it is the only one.
function causeOf({ verdict, ending, reason, expectations }) {
  if (ending === "stopped") return { words: "", stated: "" };
  const those = expectations.filter((each) => each.verdict === verdict && each.reason);
  if (verdict === "error" || !those.length) return { words: plain(reason), stated: "" };
  const [{ name, reason: stated }] = those,
    alike = those.filter((each) => each.reason === stated).length,
    more = those.length - alike;
  return {
    words: `${alike === 1 ? `${name}: ` : ""}${plain(stated)}${more ? `; ${more} more below` : ""}`,
    stated,
  };
}

function headline({ ending, expectations }, cause, time) {
  if (ending === "stopped")
    return typeof time === "number" ? `Stopped at ${time.toFixed(3)} s.` : "Stopped before it began.";
  const count = expectations.length;
  if (cause) return `${ending[0].toUpperCase()}${ending.slice(1)}: ${cause}`;
  if (count) return count === 1 ? "The expectation holds." : `Each of ${count} expectations holds.`;
  return about.scenario ? "The scenario has no expectations." : "The run has ended.";
}

function showEnd(end, time) {
  hasEnded = true;
  find("commands").disabled = true;
  const isJudged = end.expectations.length > 0 || end.verdict !== "pass",
    code = end.exit_code ? ` (exit code ${end.exit_code})` : "",
    cause = causeOf(end);
  showPhase("ended", isJudged ? end.ending : "");
  find("end").hidden = false;
  find("end").className = isJudged ? end.ending : "";
  find("end-reason").textContent = headline(end, cause.words, time) + code;
  find("end-next").textContent = about.starts
    ? "Start a scenario to go on."
    : about.ends_with_run
      ? "To go on, start again and open the new address. With LIFTGATE_HIL_TOKEN set, this page reconnects by itself."
      : "The next run on this bus is shown as soon as it begins.";
  showVerdicts(end.expectations, cause.stated);
  find("hold").hidden = true;
  find("scene-help").textContent = SCALE; // nothing can be dragged any more
  charts.resize(); // the charts have less room
  if (!isHeld) zoomToPeak(end);
}

// Shows where the pinch force of the run was largest, or says why not; without a contact the whole run.
function zoomToPeak({ pinch_peak_n: force, pinch_peak_s: time }) {
  const [begin, end] = [charts.times[0], charts.times.at(-1)],
    isGone = time !== null && time < begin,
    contact = isGone ? null : charts.largestContact();
  find("end-peak").textContent = isGone
    ? `The largest pinch force, ${text(force, 0)} N, was at ${text(time, 1)} s; the charts keep the last ${text(end - begin, 0)} s.`
    : "";
  if (!contact) {
    find("whole").click();
    return;
  }
  charts.now = contact.peak_s;
  zoomTo(...around(contact).map((time) => within(time, begin, end)));
}
