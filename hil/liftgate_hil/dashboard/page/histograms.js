"use strict";
// Histograms of durations.

// A histogram: bars [from, to, count] over a logarithmic axis of durations.
function drawHistogram(svg, bars) {
  svg.replaceChildren();
  if (!bars.length) return;
  const low = Math.max(bars[0][0], 0.1),
    high = bars[bars.length - 1][1],
    most = Math.log1p(Math.max(...bars.map(([, , count]) => count)));
  const x = (value) => 6 + (348 * Math.log(Math.max(value, low) / low)) / Math.log(high / low);
  const first = Math.ceil(Math.log10(low)),
    every = Math.log10(high / low) > 4.5 ? 2 : 1; // labels of more decades would touch each other
  for (let power = first; 10 ** power <= high; power += 1) {
    const at = x(10 ** power);
    shape("path", { d: `M${at} 6V92` }, svg);
    if ((power - first) % every) continue;
    const anchor = at > 335 ? "end" : at < 20 ? "start" : "middle";
    shape("text", { x: at, y: 106, "text-anchor": anchor }, svg).textContent = text(10 ** power);
  }
  for (const [from, to, count] of bars) {
    if (!count) continue;
    const height = Math.max(1.5, (82 * Math.log1p(count)) / most);
    const bar = shape(
      "rect",
      { x: x(from), y: 92 - height, width: Math.max(1, x(to) - x(from) - 0.5), height },
      svg,
    );
    shape("title", {}, bar).textContent = `${text(from, 2)} to ${text(to, 2)} µs: ${count}`;
  }
}
