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

function showGauge(now, peak) {
  const most = charts.limits.map(({ force_n: limit }) => limit),
    full = Math.max(1.3 * Math.max(0, ...most), peak || 0, now || 0) || 100,
    x = (force) => 1 + 198 * within((force || 0) / full, 0, 1);
  find("gauge-now").setAttribute("width", x(now) - 1);
  find("gauge-now").classList.toggle("over", isOver(now));
  find("gauge-peak").setAttribute("d", peak > 0 ? `M${x(peak)} 2V16` : "");
  most.forEach((limit, k) => find("gauge-limits").children[k].setAttribute("d", `M${x(limit)} 1V20`));
  const words = {
    "gauge-force": `Pinch force ${text(now, 0)} N`,
    "gauge-peak-text": peak > 0 ? `last peak ${text(peak, 0)} N` : "",
  };
  for (const [name, each] of Object.entries(words)) {
    if (find(name).textContent !== each) find(name).textContent = each;
  }
}

// The name of an expectation with its formula, made once each.
const named = new Map();
function nameOf(expectation) {
  const formula = about.expectations?.[expectation];
  if (!formula) return expectation;
  if (!named.has(expectation))
    named.set(
      expectation,
      element("div", {}, expectation, element("div", { className: "meaning" }, formula)),
    );
  return named.get(expectation);
}

function showVerdicts(verdicts) {
  if (!verdicts || !verdicts.length) return;
  find("verdicts").hidden = false;
  const table = find("verdicts").querySelector("table");
  rows(
    table,
    verdicts.map((each) => [
      nameOf(each.name),
      each.verdict,
      each.margin === null ? "" : `${text(each.margin, 3)} ${each.margin_unit}`,
      each.time_s === null ? "" : `${text(each.time_s, 3)} s`,
    ]),
  );
  [...table.tBodies[0].rows].forEach((row, k) => {
    row.cells[1].className = verdicts[k].verdict;
  });
}

function showEnd(end) {
  hasEnded = true;
  find("commands").disabled = true;
  const isJudged = end.expectations.length > 0 || end.verdict !== "pass",
    code = end.exit_code ? ` (exit code ${end.exit_code})` : "",
    reason = (end.reason || "").replaceAll("`", "");
  showPhase("ended", isJudged ? end.verdict : "");
  find("end").hidden = false;
  find("end").className = isJudged ? end.verdict : "";
  find("end-reason").textContent =
    (reason ||
      (isJudged
        ? `Each of ${numberOf(end.expectations.length, "expectation")} holds.`
        : about.scenario
          ? "The scenario has no expectations."
          : "The run was stopped.")) + code;
  find("end-next").textContent = about.starts
    ? "Start a scenario to go on."
    : about.ends_with_run
      ? "The page reconnects to the next run, or to a recording, at this address with the same token."
      : "The next run on this bus is shown as soon as it begins.";
  showVerdicts(end.expectations);
  find("hold").hidden = true;
  find("scene-help").textContent = SCALE; // nothing can be dragged any more
  charts.resize(); // the charts have less room
  if (!isHeld) zoomToPeak();
}

// Shows where the pinch force was largest; without a contact the whole run.
function zoomToPeak() {
  const contact = charts.largestContact();
  if (!contact) {
    find("whole").click();
    return;
  }
  charts.now = contact.peak_s;
  zoomTo(...around(contact).map((time) => within(time, charts.times[0], charts.times.at(-1))));
}
