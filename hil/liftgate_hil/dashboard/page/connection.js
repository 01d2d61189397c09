"use strict";
// The connection to the server: commands and their replies, the stream of states, and its loss.

const HISTORY_S = 300; // of a run that is kept here
const PROBE_MS = 2000; // between two looks for a server that has gone
const SILENCE_MS = 2000; // without a state, of which 30 come in a second
const REPLY_MS = 5000; // for the reply to a command; the server does not execute one that is given up before it looks
let wire = null; // the stream
let heard = 0; // when the last state came
let isUnheard = false; // no states come
let isGone = false; // the server
const ANSWER_MS = 8000; // that an answer is shown
let answered = null;
function answer(words, isBad) {
  find("answer").className = isBad ? "bad" : "";
  find("answer").textContent = words;
  clearTimeout(answered);
  if (!isBad)
    answered = setTimeout(() => {
      find("answer").textContent = "";
    }, ANSWER_MS);
}

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
  const reply = await post("/api/command", content, AbortSignal.timeout(REPLY_MS));
  if (reply) answer(reply.waits || `${text(reply.time_s, 3)} s: ${reply.done}`, false);
  return reply;
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
    if (about.kind === "recording") {
      point(state.time_s);
      if (state.is_over) stop();
    } else if (state.span && state.span.low) {
      charts.append(state.time_s, state.span, HISTORY_S);
      if (!isHeld) follow();
    }
    show(state);
  };
  wire.onclose = () => {
    wire = null;
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
