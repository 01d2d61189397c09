"use strict";
// The connection to the server: commands and their replies, the stream of states, and its loss.

const HISTORY_S = 300; // of a run that is kept here
const PROBE_MS = 2000; // between two looks for a server that has gone
const SILENCE_MS = 2000; // without a state, of which 30 come in a second
const MOST_LINES = 200; // of the log that are kept for a page in the background
const STILL_MS = 100; // at least, between two drawings of the charts, and of the page while the gate stands
const STILL_DEG = 0.01; // by which a gate that stands may move
const REPLY_MS = 5000; // for the reply to a command; the server does not execute one that is given up before it looks
let wire = null; // the stream
let heard = 0; // when the last state came
let unshown = null; // state that the next frame shows
let shownAt = 0; // when the charts were drawn last
let isUnheard = false; // no states come
let isGone = false; // the server
const ANSWER_MS = 4000; // that an answer is shown; what is refused stays until it is closed, or the next answer
const WAITS_MS = 500; // without a reply, after which a command is said to wait
const WAITS = "the run is not advancing: the command takes effect when it goes on";
let answered = null;
function answer(words, isBad) {
  find("answer").className = isBad ? "bad" : "";
  find("answer").textContent = words;
  clearTimeout(answered);
  if (!isBad) answered = setTimeout(dismiss, ANSWER_MS);
}

function dismiss() {
  clearTimeout(answered);
  find("answer").textContent = "";
}
find("close-answer").onclick = dismiss;
addEventListener("keydown", (event) => {
  if (event.key === "Escape") dismiss();
});

async function post(where, content, signal = undefined) {
  if (isGone) {
    answer("no connection to the server", true);
    return null;
  }
  try {
    const response = await fetch(path(where), {
      method: "POST",
      body: JSON.stringify(content),
      headers: { "Content-Type": "application/json" },
      keepalive: true,
      signal,
    });
    const reply = await response.json();
    if (!response.ok) {
      answer(reply.issues.map((each) => each.replaceAll("`", "")).join("\n"), true);
      return null;
    }
    return reply;
  } catch (error) {
    const isLate = error.name === "TimeoutError";
    answer(isLate ? "no reply for five seconds: given up" : "no connection to the server", true);
    return null;
  }
}

// Asks for something that the server knows; null: it is gone.
async function ask(where) {
  try {
    return await (await fetch(path(where))).json();
  } catch {
    if (!isGone) gone();
    return null;
  }
}

async function command(content) {
  const waits = setTimeout(() => answer(WAITS, false), WAITS_MS);
  const reply = await post("/api/command", content, AbortSignal.timeout(REPLY_MS));
  clearTimeout(waits);
  const silent = content.request && last && isSilent(last) ? ", and no ECU sends commands" : "";
  if (reply)
    answer(
      reply.waits ? WAITS : `${text(reply.time_s, 3)} s: ${doneWords(content, reply.done)}${silent}`,
      false,
    );
  return reply;
}

// Shows the state that came last, once per frame of the browser: a busy machine draws fewer states and none of them late.
function showLatest() {
  const state = unshown,
    now = performance.now(),
    isDue = now > shownAt + STILL_MS;
  if (!state) return;
  if (wire && !isDue && isStill(state)) {
    setTimeout(() => requestAnimationFrame(showLatest), shownAt + STILL_MS - now);
    return;
  }
  unshown = null;
  if (about.kind === "recording") point(state.time_s);
  else if (isDue) {
    shownAt = now;
    if (!isHeld) follow();
  }
  show(state);
}

// Whether the gate of a run stands where it is shown.
function isStill(state) {
  return (
    about.kind === "run" && last && Math.abs(state.truth.gate_angle_deg - last.truth.gate_angle_deg) < STILL_DEG
  );
}

function connect() {
  wire = new WebSocket(
    path(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/stream`),
  );
  heard = performance.now();
  wire.onmessage = (event) => {
    heard = performance.now();
    if (isUnheard) silence(false);
    const state = JSON.parse(event.data);
    if (state.number !== undefined && state.number !== about.number) {
      location.reload(); // the next run
      return;
    }
    if (about.kind !== "recording" && state.span && state.span.low)
      charts.append(state.time_s, state.span, HISTORY_S);
    if (state.is_over) stop();
    if (!unshown) requestAnimationFrame(showLatest);
    // What comes less often, and each line of the log, is kept of the states that are not shown.
    const lines = [...(unshown?.log ?? []), ...(state.log ?? [])];
    unshown = { ...unshown, ...state, log: lines.slice(-MOST_LINES) };
  };
  wire.onclose = () => {
    wire = null;
    showLatest();
    if (!isGone) gone();
  };
}

// A server that stands still keeps its connections: only the missing states tell.
setInterval(() => {
  if (wire && about.kind !== "recording" && !hasEnded && performance.now() > heard + SILENCE_MS) silence(true);
}, SILENCE_MS / 4);

function silence(isSo) {
  isUnheard = isSo;
  find("commands").disabled = isSo;
  if (isSo) showPhase("silent");
}

// The server is gone. A frame, unlike a request, fails without an entry in the browser's console.
function gone() {
  isGone = true;
  find("commands").disabled = true;
  if (!hasEnded) showPhase("lost");
  else if (!about.ends_with_run)
    find("end-next").textContent = "No connection: the page's server has ended. Start it again to go on.";
  find("play").textContent = "Play";
  const frame = element("iframe", { hidden: true, title: "connection" });
  frame.onload = () => {
    let content = "";
    try {
      content = frame.contentDocument.body.textContent;
    } catch {
      /* nobody answers yet */
    }
    frame.remove();
    if (content.includes('"kind"')) {
      location.reload();
      return;
    }
    if (content.includes('"issues"')) {
      find("end-next").textContent = "Another server answers here now: open the address that it printed.";
      return;
    }
    setTimeout(gone, PROBE_MS);
  };
  frame.src = path("/api/about");
  document.body.append(frame);
}
