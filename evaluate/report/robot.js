// The robot: its motion decoded, where its parts are, and how it looks from above.
// Joint k of the paper is index k - 1 here. Lengths in m, angles in rad, times in s.

function bytes(text) {
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;
}

/** Joint angles of every frame, one after the other, from 16-bit integers. */
function decodeAngles(text, robot) {
  const view = new DataView(bytes(text));
  const angles = new Float64Array(view.byteLength / 2);
  for (let k = 0; k < angles.length; k++) angles[k] = view.getInt16(2 * k, true) * robot.quantum;
  return angles;
}

/** 32-bit floats, one after the other. */
function decodeFloats(text) {
  const view = new DataView(bytes(text));
  const floats = new Float64Array(view.byteLength / 4);
  for (let k = 0; k < floats.length; k++) floats[k] = view.getFloat32(4 * k, true);
  return floats;
}

/** One policy's episode, decoded. */
class Run {
  constructor(data, robot) {
    this.robot = robot;
    this.end = data.end;
    this.time = data.time;
    this.outcome = data.outcome;
    this.error = data.error;
    this.lastPhase = data.phase;
    this.phases = data.phases;
    this.modes = data.modes;
    this.lifted = data.lifted;
    this.phi = decodeAngles(data.phi, robot);
    this.w = data.w ? decodeFloats(data.w) : null;
    this.frames = this.phi.length / robot.n_joints;
  }

  /** When a frame was: they are evenly spaced, but the last is at the end. */
  timeOf(frame) {
    return frame === this.frames - 1 ? this.end : frame * this.robot.frame_s;
  }

  /** Joint angles and head pose at a time, between two frames in proportion. */
  at(time) {
    const last = this.frames - 1;
    const now = Math.min(Math.max(time, 0), this.end);
    const before = Math.max(0, Math.min(last - 1, Math.floor(now / this.robot.frame_s)));
    const after = Math.min(last, before + 1);
    const span = this.timeOf(after) - this.timeOf(before);
    const share = span > 0 ? Math.min(1, (now - this.timeOf(before)) / span) : 1;
    const mix = (values, width, k) =>
      values[before * width + k] * (1 - share) + values[after * width + k] * share;
    const n = this.robot.n_joints;
    return {
      phi: Array.from({ length: n }, (_, k) => mix(this.phi, n, k)),
      w: this.w ? [0, 1, 2].map((k) => mix(this.w, 3, k)) : this.robot.w_d,
      tips: this.outcome === "stability" && time >= this.end, // rounded angles may not show it
    };
  }

  /** The interval at a time; at the end of the episode the last one, -1 if there is none. */
  interval(time) {
    return Math.min(Math.floor(time / this.robot.delta_t + 1e-9), this.phases.length - 1);
  }

  /** Whether a wheel (1..n) is in the air during an interval. */
  isLifted(interval, wheel) {
    return interval >= 0 && Boolean((this.lifted[interval] >> (wheel - 1)) & 1);
  }

  get solved() {
    return this.outcome === "success";
  }

  /** Whether a limit was passed, at which such an episode ends at once. */
  get violated() {
    return ["stability", "joint_limit", "collision"].includes(this.outcome);
  }

  /** Whether it chose no modes and dragged the head along. */
  get skids() {
    return Boolean(this.w) && this.modes.length === 0;
  }
}

/** Places of the robot's parts: the same as snake_env.drawing.geometry. */
function geometry(phi, w, robot) {
  const { l, track } = robot;
  let heading = w[2];
  let front = [w[0], w[1]];
  const outline = [front];
  const centres = [];
  const axles = [];
  const headings = [heading];
  for (let k = 0; k <= robot.n_joints; k++) {
    if (k > 0) headings.push((heading += phi[k - 1]));
    const [cos, sin] = [Math.cos(heading), Math.sin(heading)];
    const centre = [front[0] - l * cos, front[1] - l * sin];
    centres.push(centre);
    if (k > 0) {
      const [dx, dy] = [(-sin * track) / 2, (cos * track) / 2];
      axles.push([[centre[0] + dx, centre[1] + dy], [centre[0] - dx, centre[1] - dy]]);
    }
    front = [front[0] - 2 * l * cos, front[1] - 2 * l * sin];
    outline.push(front);
  }
  const mean = (axis) => centres.reduce((sum, point) => sum + point[axis], 0) / centres.length;
  return { outline, centres, axles, headings, gravity: [mean(0), mean(1)] };
}

/** Corners of the convex hull, anticlockwise (Andrew's monotone chain). */
function convexHull(points) {
  const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  const half = (sequence) => {
    const chain = [];
    for (const [x, y] of sequence) {
      while (chain.length > 1) {
        const [[ax, ay], [bx, by]] = chain.slice(-2);
        if ((bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0) break;
        chain.pop();
      }
      chain.push([x, y]);
    }
    return chain.slice(0, -1);
  };
  return [...half(sorted), ...half(sorted.reverse())];
}

/** Whether a point lies in a convex hull, its edge included. */
function isInside([x, y], hull) {
  return hull.every(([ax, ay], k) => {
    const [bx, by] = hull[(k + 1) % hull.length];
    return (bx - ax) * (y - ay) - (by - ay) * (x - ax) >= 0;
  });
}

/** The box [left, bottom, right, top] that the robot never leaves in some runs, with a margin. */
function boxOf(runs, target, robot) {
  const box = [Infinity, Infinity, -Infinity, -Infinity];
  const cover = (phi, w) => {
    for (const [x, y] of geometry(phi, w, robot).outline) {
      box[0] = Math.min(box[0], x);
      box[1] = Math.min(box[1], y);
      box[2] = Math.max(box[2], x);
      box[3] = Math.max(box[3], y);
    }
  };
  cover(target, robot.w_d);
  for (const run of runs) {
    for (let frame = 0; frame < run.frames; frame += 5) {
      const pose = run.at(run.timeOf(frame));
      cover(pose.phi, pose.w);
    }
  }
  const margin = 0.09;
  return [box[0] - margin, box[1] - margin, box[2] + margin, box[3] + margin];
}

/** The page's colours as canvases understand them: custom properties resolved by an element. */
function themeColours() {
  const probe = document.createElement("i");
  document.body.append(probe);
  const names = ["raised", "ink", "soft", "rule", "accent", "lifted", "support", "target"];
  const colours = {};
  for (const name of [...names, "gravity", "body"]) {
    probe.style.color = `var(--${name})`;
    colours[name] = getComputedStyle(probe).color;
  }
  probe.remove();
  return colours;
}

/** Fits a canvas to its place on the screen; its context, in CSS pixels. */
function freshContext(canvas) {
  const density = window.devicePixelRatio || 1;
  const { clientWidth: width, clientHeight: height } = canvas;
  canvas.width = Math.round(width * density);
  canvas.height = Math.round(height * density);
  const context = canvas.getContext("2d");
  context.scale(density, density);
  return { context, width, height };
}

const NEAR_LIMIT = 0.85; // share of the joint limit from which a joint is shown in colour

/** Draws the robot in a box of the world. */
class RobotView {
  constructor(canvas, robot) {
    this.canvas = canvas;
    this.robot = robot;
  }

  /** pose: {phi, w}; interval: of the run, -1 for none; target: joint angles. */
  draw(run, pose, interval, target, box, colours) {
    const { context, width, height } = freshContext(this.canvas);
    this.context = context;
    this.colours = colours;
    this.scale = Math.min(width / (box[2] - box[0]), height / (box[3] - box[1]));
    this.origin = [
      width / 2 - (this.scale * (box[0] + box[2])) / 2,
      height / 2 + (this.scale * (box[1] + box[3])) / 2,
    ];
    const body = geometry(pose.phi, pose.w, this.robot);
    const up = body.axles.map((_, k) => run.isLifted(interval, k + 1));
    const scp = interval >= 0 ? run.phases[interval] : 0;
    this.ground(width, height);
    this.ghost(geometry(target, this.robot.w_d, this.robot));
    const polygon = this.support(body, up);
    if (scp) this.range(body, scp, target[scp - 1]);
    this.wheels(body, up);
    this.links(body);
    this.joints(body, pose.phi, scp);
    this.head(body);
    const supported = polygon.length > 2 && isInside(body.gravity, polygon);
    this.gravity(body.gravity, supported && !pose.tips);
  }

  point([x, y]) {
    return [this.origin[0] + this.scale * x, this.origin[1] - this.scale * y];
  }

  trace(points, closed = false) {
    this.context.beginPath();
    for (const point of points) this.context.lineTo(...this.point(point));
    if (closed) this.context.closePath();
  }

  stroke(colour, width, dash = []) {
    const { context } = this;
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.setLineDash(dash);
    context.lineJoin = context.lineCap = "round";
    context.stroke();
    context.setLineDash([]);
  }

  fill(colour, alpha = 1) {
    this.context.globalAlpha = alpha;
    this.context.fillStyle = colour;
    this.context.fill();
    this.context.globalAlpha = 1;
  }

  disc(point, radius, colour, edge) {
    this.context.beginPath();
    this.context.arc(...this.point(point), radius, 0, 2 * Math.PI);
    this.fill(colour);
    if (edge) this.stroke(edge, 1.2);
  }

  /** A scale in the corner. */
  ground(width, height) {
    const { context, colours } = this;
    const length = 0.2 * this.scale;
    context.beginPath();
    context.moveTo(6, height - 12);
    context.lineTo(6, height - 8);
    context.lineTo(6 + length, height - 8);
    context.lineTo(6 + length, height - 12);
    this.stroke(colours.soft, 1);
    context.fillStyle = colours.soft;
    context.font = "11px system-ui, sans-serif";
    context.fillText("0.2 m", 10, height - 13);
  }

  ghost(body) {
    this.context.globalAlpha = 0.18;
    this.trace(body.outline);
    this.stroke(this.colours.target, 0.045 * this.scale);
    this.context.globalAlpha = 1;
    this.trace(body.outline);
    this.stroke(this.colours.target, 1.4, [5, 4]);
  }

  /** Draws the support polygon; its corners. */
  support(body, up) {
    const contacts = body.axles.filter((_, k) => !up[k]).flat();
    if (this.robot.head_contact) contacts.push(body.centres[0]);
    if (contacts.length < 3) return [];
    const polygon = convexHull(contacts);
    this.trace(polygon, true);
    this.fill(this.colours.support, 0.28);
    this.stroke(this.colours.support, 1);
    return polygon;
  }

  /** How far the phase's joint may turn the link behind it, and where it shall. */
  range(body, joint, target) {
    const { context, robot, scale } = this;
    const ahead = body.headings[joint - 1] + Math.PI; // straight on, seen from the joint
    const radius = 0.11 * scale;
    const centre = this.point(body.outline[joint]);
    context.beginPath();
    context.moveTo(...centre);
    context.arc(...centre, radius, -(ahead + robot.phi_limit), -(ahead - robot.phi_limit));
    context.closePath();
    this.fill(this.colours.ink, 0.07);
    const goal = ahead + target;
    context.beginPath();
    context.moveTo(...centre);
    context.lineTo(centre[0] + radius * Math.cos(goal), centre[1] - radius * Math.sin(goal));
    this.stroke(this.colours.target, 1.6);
  }

  wheels(body, up) {
    body.axles.forEach((axle, k) => {
      const colour = up[k] ? this.colours.lifted : this.colours.accent;
      this.trace(axle);
      this.stroke(colour, 1.4);
      const heading = body.headings[k + 1];
      const [cos, sin] = [Math.cos(heading), Math.sin(heading)];
      for (const [x, y] of axle) {
        const corners = [[1, 1], [-1, 1], [-1, -1], [1, -1]].map(([a, b]) => [
          x + 0.026 * a * cos - 0.009 * b * sin,
          y + 0.026 * a * sin + 0.009 * b * cos,
        ]);
        this.trace(corners, true);
        this.fill(up[k] ? this.colours.raised : colour);
        this.stroke(colour, 1.4);
      }
    });
  }

  links(body) {
    this.trace(body.outline);
    this.stroke(this.colours.body, Math.max(4, 0.026 * this.scale));
  }

  joints(body, phi, scp) {
    phi.forEach((angle, k) => {
      const share = Math.abs(angle) / this.robot.phi_limit;
      const { raised, gravity, lifted, ink } = this.colours;
      const colour = share > 0.999 ? lifted : share > NEAR_LIMIT ? gravity : raised;
      const own = k + 1 === scp;
      this.disc(body.outline[k + 1], own ? 5.5 : 4, own && colour === raised ? ink : colour, ink);
    });
  }

  head(body) {
    const [x, y] = this.point(this.robot.w_d);
    this.disc(body.outline[0], 6, this.colours.ink);
    this.context.beginPath();
    this.context.arc(x, y, 9.5, 0, 2 * Math.PI);
    this.stroke(this.colours.target, 1.4);
  }

  gravity(place, supported) {
    const [x, y] = this.point(place);
    this.disc(place, 5.5, this.colours[supported ? "gravity" : "lifted"], this.colours.ink);
    this.context.beginPath();
    this.context.moveTo(x - 8.5, y);
    this.context.lineTo(x + 8.5, y);
    this.context.moveTo(x, y - 8.5);
    this.context.lineTo(x, y + 8.5);
    this.stroke(this.colours.ink, 1);
  }
}
