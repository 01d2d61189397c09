"use strict";
// What can be dragged in the drawing: a hand on the gate, and the obstacle.

const HAND_N_PER_M = 1000,
  MOST_HAND_N = 300; // the hand pulls like a spring: chosen
const HAND_MS = 100; // between two commands of the hand
const GRIP = 13; // radius of the hand, in the drawing's own units
const APART_DEG = 25; // between the handle of the obstacle and the one that the scenario has put
const TOUCH_PX = 22; // radius in which a finger takes a handle: 44 px across, of WCAG 2.2's target size (enhanced)

class Handles {
  // `act` has `hand(newtons or null)`, `put({angle_deg, distance})` and `remove()`.
  constructor(drawing, act) {
    this.drawing = drawing;
    this.act = act;
    this.handAt = null; // where the hand pulls to [m]
    this.force = null;
    this.sent = null;
    this.rodInForce = null;
    const { open_angle_deg: open, length_m: length } = drawing.geometry;
    this.parked = { angle: 0.45 * open, distance: 1.22 * length }; // beside the gate's way
    this.rodAt = { ...this.parked };
    this.make();
    this.makeRodDraggable();
    this.makeGripDraggable();
    new ResizeObserver(() => this.fit()).observe(drawing.svg);
  }

  make() {
    const { svg, geometry, scale } = this.drawing;
    const handle = (name, radius, attributes) => {
      const group = shape("g", { id: name, class: name, tabindex: 0, role: "slider", ...attributes }, svg);
      shape("circle", { class: "touch", r: radius }, group);
      shape("circle", { class: "dot", r: radius }, group);
      return group;
    };
    this.band = shape("path", { class: "band" }, svg);
    this.rod = handle("rod", ROD_M * scale, {
      "aria-label": "Obstacle: angle at which the gate meets it",
      "aria-valuemin": 0,
      "aria-valuemax": geometry.open_angle_deg,
    });
    this.rod.classList.add("parked");
    this.grip = handle("grip", GRIP, {
      "aria-label": "Hand on the gate: force",
      "aria-valuemin": -MOST_HAND_N,
      "aria-valuemax": MOST_HAND_N,
      "aria-valuenow": 0,
    });
    this.rodText = shape("text", { class: "of-rod" }, svg);
  }

  // However small the drawing is, a finger finds the handles.
  fit() {
    const matrix = this.drawing.svg.getScreenCTM();
    if (!matrix) return;
    for (const group of [this.rod, this.grip]) {
      const [touch, dot] = group.children;
      touch.setAttribute("r", Math.max(TOUCH_PX / matrix.a, +dot.getAttribute("r")));
    }
  }

  makeRodDraggable() {
    const { open_angle_deg: open, length_m: length } = this.drawing.geometry;
    this.drags(
      this.rod,
      (point) => {
        const { angle, distance } = this.drawing.polar(point);
        this.rodAt = {
          angle: within(angle + (ROD_M / distance) * 57.3, -5, open + 5),
          distance: within(distance, 0.05, length),
        };
        this.placeRod();
      },
      (hasMoved) => {
        if (hasMoved) this.putRod();
      },
    );
    this.rod.addEventListener("keydown", (event) => {
      const step = { ArrowUp: 1, ArrowRight: 1, ArrowDown: -1, ArrowLeft: -1, PageUp: 5, PageDown: -5 }[
        event.key
      ];
      if (step) {
        this.rodAt.angle = within(this.rodAt.angle + step, 0, open);
        this.placeRod();
        if (this.rodInForce) this.putRod();
      } else if (event.key === "Enter" || event.key === " ") this.putRod();
      else if (event.key === "Delete" || event.key === "Backspace") this.act.remove();
      else return;
      event.preventDefault();
    });
  }

  makeGripDraggable() {
    this.drags(
      this.grip,
      (point) => {
        this.handAt = point;
        this.pull();
      },
      () => this.letGo(),
    );
    setInterval(() => {
      if (this.handAt) this.pull();
    }, HAND_MS);
    addEventListener("pagehide", () => {
      if (this.force !== null) this.letGo();
    });
    this.grip.addEventListener("keydown", (event) => {
      const step = { ArrowUp: 10, ArrowRight: 10, ArrowDown: -10, ArrowLeft: -10, PageUp: 50, PageDown: -50 }[
        event.key
      ];
      if (step) this.press((this.force || 0) + step);
      else if (["Escape", "Home", "Delete", "0"].includes(event.key)) this.letGo();
      else return;
      event.preventDefault();
    });
  }

  // Calls `move` with points [m] while something is dragged, and `end` once at the end with whether it was moved at all.
  drags(element, move, end) {
    let hasMoved = false;
    element.addEventListener("pointerdown", (event) => {
      if (event.button) return; // of a mouse the left one
      element.setPointerCapture(event.pointerId);
      element.classList.add("held");
      hasMoved = false;
      event.preventDefault();
    });
    element.addEventListener("pointermove", (event) => {
      if (!element.classList.contains("held")) return;
      hasMoved = true;
      move(this.drawing.pointAt(event));
    });
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) {
      element.addEventListener(kind, () => {
        if (element.classList.contains("held")) {
          element.classList.remove("held");
          end(hasMoved);
        }
      });
    }
  }

  // The hand pulls the gate towards the pointer, the harder the further it is.
  pull() {
    const { geometry, angle } = this.drawing,
      distance = geometry.hand_distance_m || geometry.length_m;
    const apart = rad(this.drawing.polar(this.handAt).angle - angle) * distance;
    this.press(within(HAND_N_PER_M * apart, -MOST_HAND_N, MOST_HAND_N));
  }

  press(newtons) {
    this.force = Math.round(within(newtons, -MOST_HAND_N, MOST_HAND_N));
    this.sendForce();
  }

  letGo() {
    this.release();
    this.sendForce();
  }

  // The hand's force was commanded elsewhere: a hand that is still held commands no more.
  drop() {
    this.release();
    this.sent = null;
  }

  release() {
    this.grip.classList.remove("held");
    this.handAt = this.force = null;
  }

  // At most one command in HAND_MS, and only what has changed.
  sendForce() {
    if (this.waiting) return;
    if (this.sent === this.force) return;
    this.sent = this.force;
    this.act.hand(this.force);
    this.waiting = setTimeout(() => {
      this.waiting = null;
      this.sendForce();
    }, HAND_MS);
  }

  putRod() {
    this.act.put({
      angle_deg: +this.rodAt.angle.toFixed(2),
      distance: +Math.min(this.rodAt.distance, this.drawing.geometry.length_m).toFixed(3),
    });
  }

  placeRod() {
    const { drawing } = this,
      { angle, distance } = this.rodAt,
      [x, y] = drawing.at(drawing.onGate(distance, -ROD_M, angle));
    this.rod.setAttribute("transform", `translate(${x} ${y})`);
    this.rod.setAttribute("aria-valuenow", angle.toFixed(1));
    this.rod.setAttribute(
      "aria-valuetext",
      `${angle.toFixed(1)} degrees, ${this.rodInForce ? "in the way" : "not in the way"}`,
    );
    this.rodText.textContent =
      this.rodInForce || this.rod.classList.contains("held")
        ? `obstacle ${angle.toFixed(1)}°`
        : this.isGiven
          ? "another one: drag it"
          : "obstacle: drag it";
    const isRight = x > WIDTH / 2; // then the text ends near the edge
    this.rodText.setAttribute("text-anchor", isRight ? "end" : "start");
    this.rodText.setAttribute("x", isRight ? Math.min(x + 60, WIDTH - 4) : Math.max(x - 40, 2));
    const isBelow = drawing.at(drawing.handAt())[1] < y, // on the side where the hand is not
      apart = Math.max(ROD_M * drawing.scale, GRIP) + 2;
    this.rodText.setAttribute("dominant-baseline", isBelow ? "text-before-edge" : "text-after-edge");
    this.rodText.setAttribute("y", isBelow ? y + apart : y - apart);
  }

  // The handle of the obstacle where it is not in the gate's way, nor beside the obstacle that is `given`.
  park(given) {
    const { angle, distance } = this.parked;
    const isNear = given && Math.abs(given.angle_deg - angle) < APART_DEG;
    const away = given && given.angle_deg < angle + APART_DEG / 2 ? APART_DEG : -APART_DEG;
    this.rodAt = { angle: isNear ? given.angle_deg + away : angle, distance };
  }

  // Shows the obstacle that was commanded, the hand's force [N], and the obstacle that the scenario has put, or null.
  show(obstacle, hand, given) {
    const { drawing } = this,
      { geometry } = drawing,
      isTaken = this.rod.classList.contains("held") || document.activeElement === this.rod;
    const grip = drawing.at(drawing.handAt());
    this.isGiven = Boolean(given);
    this.grip.setAttribute("transform", `translate(${grip[0]} ${grip[1]})`);
    this.grip.setAttribute("aria-valuenow", Math.round(hand));
    this.grip.setAttribute(
      "aria-valuetext",
      hand ? `${Math.round(Math.abs(hand))} newtons, ${hand > 0 ? "opening" : "closing"}` : "no force",
    );
    this.band.setAttribute(
      "d",
      this.handAt ? `M${grip[0]} ${grip[1]}L${drawing.at(this.handAt).join(" ")}` : "",
    );
    const isOffered = !find("commands").disabled;
    for (const each of [this.rod, this.rodText]) each.style.display = isOffered || obstacle ? "" : "none";
    this.grip.style.display = isOffered || hand ? "" : "none";
    this.rodInForce = obstacle;
    this.rod.classList.toggle("parked", !obstacle);
    if (obstacle && !isTaken)
      this.rodAt = { angle: obstacle.angle_deg, distance: obstacle.distance ?? geometry.length_m };
    else if (!obstacle && (this.wasInForce || (given?.angle_deg !== this.givenAt && !isTaken)))
      this.park(given);
    this.wasInForce = Boolean(obstacle);
    this.givenAt = given?.angle_deg;
    this.placeRod();
  }
}
