"use strict";
// Drawing of car and gate to scale, with the forces that act on the gate.

const WIDTH = 640,
  HEIGHT = 400; // of the drawing, in its own units
const METRES_PER_NEWTON = 0.0006; // of an arrow
const LEAST_N = 5; // below which a force has no arrow
const FORCES = {
  left: "left drive",
  right: "right drive",
  left_spring: "left spring",
  right_spring: "right spring",
  weight: "weight",
  hand: "hand",
  pinch: "pinch",
};
const isNarrow = matchMedia("(max-width: 900px)"); // where page.css has larger letters
const LINE = 22,
  COLUMN = () => (isNarrow.matches ? 250 : 180),
  ROWS = 4; // of the legend: between two lines and two columns of text; lines above the car's roof
const ROD_M = 0.045; // radius of the obstacle as it is drawn

function shape(name, attributes = {}, parent = null) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (parent) parent.append(made);
  return made;
}

const rad = (degrees) => (degrees * Math.PI) / 180;
const within = (value, low, high) => Math.min(high, Math.max(low, value));

class Drawing {
  // `act` has `hand(newtons or null)`, `put({angle_deg, distance})` and `remove()`; null: nothing can be commanded.
  constructor(svg, geometry, act) {
    this.svg = svg;
    this.geometry = geometry;
    this.angle = 0;
    this.slope = 0;
    this.fit();
    this.make();
    this.handles = act && new Handles(this, act);
    isNarrow.addEventListener("change", () => this.placeLegend());
  }

  // Scale and origin, so that the gate, and a finger on the hand's handle, have room from closed to open.
  fit() {
    const { hinge, edge, length_m: length, angles_deg: angles } = this.geometry;
    const xs = edge.map(([x]) => x),
      ys = [...edge, ...angles.map((angle) => this.handAt(angle))].map(([, y]) => y);
    const low = [hinge[0] - 1.05 * length, Math.min(...ys) - 0.7 * length];
    const high = [Math.max(...xs, hinge[0]) + 0.3 * length, Math.max(...ys, hinge[1]) + 0.28 * length];
    this.scale = Math.min(WIDTH / (high[0] - low[0]), HEIGHT / (high[1] - low[1]));
    this.centre = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
    this.ground = Math.min(...ys) - 0.52 * length;
  }

  // A point [m] of the car, turned by the slope of the road, in the drawing.
  at([x, y]) {
    const [hx, hy] = this.geometry.hinge,
      c = Math.cos(rad(this.slope)),
      s = Math.sin(rad(this.slope));
    const dx = x - hx,
      dy = y - hy;
    const [wx, wy] = [hx + c * dx - s * dy, hy + s * dx + c * dy];
    return [WIDTH / 2 + (wx - this.centre[0]) * this.scale, HEIGHT / 2 - (wy - this.centre[1]) * this.scale];
  }

  // The point [m] of the car at a place on the screen.
  pointAt(event) {
    const found = new DOMPoint(event.clientX, event.clientY).matrixTransform(
      this.svg.getScreenCTM().inverse(),
    );
    const [hx, hy] = this.geometry.hinge,
      c = Math.cos(rad(this.slope)),
      s = Math.sin(rad(this.slope));
    const wx = this.centre[0] + (found.x - WIDTH / 2) / this.scale - hx,
      wy = this.centre[1] - (found.y - HEIGHT / 2) / this.scale - hy;
    return [hx + c * wx + s * wy, hy - s * wx + c * wy];
  }

  // The point at a distance from the hinge on the gate's inner face, and `out` of it, at an angle of the gate.
  onGate(distance, out = 0, angle = this.angle) {
    const { hinge, closed_deg: closed } = this.geometry,
      way = rad(closed + angle);
    return [
      hinge[0] + distance * Math.cos(way) - out * Math.sin(way),
      hinge[1] + distance * Math.sin(way) + out * Math.cos(way),
    ];
  }

  // Where a hand takes the gate, outside of it.
  handAt(angle = this.angle) {
    return this.onGate(this.geometry.hand_distance_m, this.geometry.thickness_m + 0.04, angle);
  }

  // A point of the closed gate, turned to the gate's angle.
  turned([x, y]) {
    const [hx, hy] = this.geometry.hinge,
      c = Math.cos(rad(this.angle)),
      s = Math.sin(rad(this.angle));
    return [hx + c * (x - hx) - s * (y - hy), hy + s * (x - hx) + c * (y - hy)];
  }

  // Angle of the gate and distance from the hinge at which its inner face passes a point.
  polar([x, y]) {
    const [hx, hy] = this.geometry.hinge;
    let angle = (Math.atan2(y - hy, x - hx) * 180) / Math.PI - this.geometry.closed_deg;
    angle = ((((angle + 180) % 360) + 360) % 360) - 180;
    return { angle, distance: Math.hypot(x - hx, y - hy) };
  }

  line(...points) {
    return (
      "M" +
      points
        .map((each) =>
          this.at(each)
            .map((n) => n.toFixed(1))
            .join(" "),
        )
        .join("L")
    );
  }

  make() {
    this.svg.replaceChildren();
    const add = (name, attributes) => shape(name, attributes, this.svg);
    const defs = add("defs", {});
    const head = shape(
      "marker",
      {
        id: "head",
        viewBox: "0 0 10 10",
        refX: 7,
        refY: 5,
        markerWidth: 4,
        markerHeight: 4,
        orient: "auto-start-reverse",
      },
      defs,
    );
    shape("path", { d: "M0 0L10 5L0 10z", fill: "context-stroke" }, head);
    this.groundLine = add("path", { class: "ground" });
    this.bodyShape = add("path", { class: "body" });
    this.pane = add("path", { class: "pane" });
    this.wheel = add("circle", { class: "wheel" });
    this.hub = add("circle", { class: "body" });
    this.sweep = add("path", { class: "range" });
    this.drives = {};
    for (const side of Object.keys(this.geometry.drives)) {
      this.drives[side] = {
        shaft: add("path", { class: `shaft ${side}` }),
        tube: add("path", { class: `tube ${side}` }),
        coil: add("path", { class: `coil ${side}` }),
      };
    }
    this.given = add("g", {});
    this.plate = add("path", { class: "plate", id: "gate" });
    this.latch = add("path", { class: "latch" });
    this.arrows = {};
    for (const [name, words] of Object.entries(FORCES)) {
      if (name.startsWith("right") && !this.geometry.drives.right) continue;
      const looks = { class: `arrow ${name.replace("_", " ")}`, "marker-end": "url(#head)" };
      this.arrows[name] = {
        sample: add("path", looks),
        path: add("path", looks),
        text: add("text", {}),
        words,
      };
    }
    this.placeLegend();
    this.labels = {};
    for (const [k, name] of ["angle", "latch", "slope"].entries())
      this.labels[name] = add("text", { x: WIDTH - 10, y: 18 + LINE * k, "text-anchor": "end" });
  }

  placeLegend() {
    Object.values(this.arrows).forEach(({ sample, text: label }, place) => {
      const x = 10 + COLUMN() * Math.floor(place / ROWS),
        y = 18 + LINE * (place % ROWS);
      sample.setAttribute("d", `M${x} ${y - 4}h20`);
      label.setAttribute("x", x + 32);
      label.setAttribute("y", y);
    });
  }

  // The arrow of a force, from a point in the drawing along a direction; the list beside says how large it is, or that
  // nobody knows.
  arrow(name, from, way, newtons) {
    const { path, text: label, words } = this.arrows[name],
      isKnown = typeof newtons === "number",
      isShown = isKnown && Math.abs(newtons) >= LEAST_N;
    label.textContent = `${words} ${isKnown ? `${Math.round(newtons)} N` : "–"}`;
    path.style.display = isShown ? "" : "none";
    if (!isShown) return;
    const length = within(newtons * METRES_PER_NEWTON, -0.6, 0.6) * this.scale,
      [x, y] = from;
    path.setAttribute(
      "d",
      `M${x.toFixed(1)} ${y.toFixed(1)}L${(x + length * way[0]).toFixed(1)} ${(y + length * way[1]).toFixed(1)}`,
    );
  }

  // Draws a state, or hides the drawing where the gate's angle is not known; returns whether it is: `values` has the columns of truth, `obstacle` was commanded, `acting` says what acts on the gate.
  show(values, obstacle, acting) {
    const g = this.geometry,
      length = g.length_m,
      thick = Math.max(g.thickness_m, 0.03);
    const isKnown = typeof values.gate_angle_deg === "number";
    this.svg.style.display = isKnown ? "" : "none";
    if (!isKnown) return false;
    this.angle = values.gate_angle_deg;
    this.slope = values.road_slope_deg || 0;
    const edge = g.edge[0],
      [hx, hy] = g.hinge,
      y0 = this.ground;
    this.groundLine.setAttribute("d", this.line([hx - 3 * length, y0], [hx + 3 * length, y0]));
    const roof = 0.05 * length,
      front = hx - 1.6 * length;
    this.bodyShape.setAttribute(
      "d",
      this.line(
        [front, hy - 0.02 * length],
        [front + 0.5 * length, hy + roof],
        [hx - 0.05 * length, hy + roof],
        [hx, hy + 0.01 * length],
        [hx - 0.02 * length, hy - 0.05 * length],
        [hx - 0.14 * length, hy - 0.08 * length],
        [edge[0] - 0.36 * length, edge[1] + 0.03 * length],
        [edge[0] - 0.02 * length, edge[1] - 0.015 * length],
        [edge[0] + 0.1 * length, edge[1] - 0.05 * length],
        [edge[0] + 0.11 * length, edge[1] - 0.22 * length],
        [edge[0] - 0.05 * length, edge[1] - 0.3 * length],
        [front, edge[1] - 0.3 * length],
      ) + "Z",
    );
    this.pane.setAttribute(
      "d",
      this.line(
        [front + 0.12 * length, hy - 0.4 * length],
        [front + 0.55 * length, hy - 0.07 * length],
        [hx - 0.3 * length, hy - 0.07 * length],
        [edge[0] - 0.55 * length, hy - 0.4 * length],
      ) + "Z",
    );
    const [wx, wy] = this.at([edge[0] - 0.75 * length, y0 + 0.3 * length]);
    this.wheel.setAttribute("cx", wx);
    this.wheel.setAttribute("cy", wy);
    this.wheel.setAttribute("r", 0.3 * length * this.scale);
    this.hub.setAttribute("cx", wx);
    this.hub.setAttribute("cy", wy);
    this.hub.setAttribute("r", 0.17 * length * this.scale);
    this.sweep.setAttribute("d", this.line(...g.edge));
    this.plate.setAttribute(
      "d",
      this.line(
        this.onGate(0),
        this.onGate(length),
        this.onGate(length * 0.985, thick * 0.8),
        this.onGate(length * 0.6, thick),
        this.onGate(0.04 * length, thick * 0.7),
      ) + "Z",
    );
    this.plate.dataset.angle = this.angle.toFixed(3);
    this.showDrives(values, acting.spring_health || {});
    this.showLatch(values);
    const rod = acting.obstacle;
    this.showForces(values, rod || obstacle);
    this.isGiven = Boolean(rod && !obstacle); // by the scenario
    this.given.replaceChildren(...(this.isGiven ? this.givenRod(rod) : []));
    this.label("angle", `gate ${this.angle.toFixed(1)}°`);
    this.label("slope", this.slope ? `slope of the road ${this.slope.toFixed(1)}°` : "");
    if (this.handles) this.handles.show(obstacle, values.hand_force_n || 0, this.isGiven ? rod : null);
    return true;
  }

  givenRod(rod) {
    const [x, y] = this.at(this.onGate(rod.distance, -ROD_M, rod.angle_deg)),
      radius = ROD_M * this.scale,
      isRight = x < WIDTH - 120, // there is room beside it
      words = shape("text", {
        x: isRight ? x + radius + 5 : x - radius - 5,
        y: y + 4,
        "text-anchor": isRight ? "start" : "end",
      });
    words.textContent = "obstacle";
    return [shape("circle", { class: "given", cx: x, cy: y, r: radius }), words];
  }

  label(name, text) {
    this.labels[name].textContent = text;
  }

  // The drives lie side by side across the car; here the right one is drawn a little beside the left one.
  showDrives(values, springHealth) {
    for (const [side, drive] of Object.entries(this.drives)) {
      const own = this.geometry.drives[side],
        a = this.at(own.body_point),
        b = this.at(this.turned(own.gate_point[0]));
      const long = Math.hypot(b[0] - a[0], b[1] - a[1]),
        way = [(b[0] - a[0]) / long, (b[1] - a[1]) / long],
        off = side === "right" ? 7 : -7;
      const point = (along, across = 0) => [
        a[0] + along * way[0] - (off + across) * way[1],
        a[1] + along * way[1] + (off + across) * way[0],
      ];
      const tube = 0.58 * own.length_m[0] * this.scale,
        path = (...points) => "M" + points.map((each) => each.map((n) => n.toFixed(1)).join(" ")).join("L");
      drive.tube.setAttribute("d", path(point(0), point(tube)));
      drive.shaft.setAttribute("d", path(point(tube), point(long)));
      const turns = 12,
        coil = [];
      for (let k = 0; k <= 2 * turns; k += 1)
        coil.push(point(tube + ((long - tube) * k) / (2 * turns), k % 2 ? 4.5 : -4.5));
      drive.coil.setAttribute("d", path(...coil));
      const { [side]: health = 1 } = springHealth; // null: not known
      drive.coil.style.opacity = within(health ?? 1, 0.15, 1);
      this.arrow(side, point(long, side === "right" ? 15 : -15), way, values[`${side}_force_n`]);
      this.arrow(
        `${side}_spring`,
        point(long, side === "right" ? 26 : -26),
        way,
        health === null ? null : health * this.springAt(side),
      );
    }
  }

  // The force of a drive's spring as the vehicle file has it, at the gate's angle.
  springAt(side) {
    const { angles_deg: angles, drives } = this.geometry,
      forces = drives[side].spring_n;
    const share =
      within((this.angle - angles[0]) / (angles[angles.length - 1] - angles[0]), 0, 1) * (angles.length - 1);
    const low = Math.min(Math.floor(share), angles.length - 2);
    return forces[low] + (share - low) * (forces[low + 1] - forces[low]);
  }

  showLatch(values) {
    const { latched } = values,
      isOpen = !(latched >= 0.5),
      plain = typeof latched === "number" ? (isOpen ? "open" : "closed") : "–",
      at = this.geometry.latch_distance_m || this.geometry.length_m;
    const [x, y] = this.at(this.onGate(Math.min(at, this.geometry.length_m), 0, 0));
    this.latch.setAttribute("class", `latch ${isOpen ? "open" : "closed"}`);
    this.latch.setAttribute("d", isOpen ? `M${x - 4} ${y + 14}v-8h8` : `M${x - 6} ${y + 14}v-16h10v7`);
    const position = ["open", "half closed", "closed"][Math.round(values.latch_position)];
    this.label(
      "latch",
      `latch ${position && this.geometry.latch_has_positions ? position : plain}`,
    );
  }

  showForces(values, obstacle) {
    const g = this.geometry,
      tangent = (angle) => {
        const a = this.at(this.onGate(1, 0, angle)),
          b = this.at(this.onGate(1, 0.01, angle));
        const long = Math.hypot(b[0] - a[0], b[1] - a[1]);
        return [(b[0] - a[0]) / long, (b[1] - a[1]) / long];
      };
    const opens = tangent(this.angle);
    this.arrow("weight", this.at(this.turned(g.gravity_point[0])), [0, 1], g.weight_n);
    const way = obstacle && obstacle.meets === "opening" ? opens : opens.map((each) => -each);
    const touched = this.at(this.onGate((obstacle && obstacle.distance) || g.length_m));
    this.arrow("pinch", touched, way, values.pinch_force_n);
    const hand = values.hand_force_n,
      grip = this.at(this.handAt()),
      beside = Math.sign(hand || 0) * 15;
    this.arrow("hand", [grip[0] + beside * opens[0], grip[1] + beside * opens[1]], opens, hand);
  }
}
