// What a run does over time: phases, wheels, joint angles and joint velocities.

const TRACES = { left: 42, right: 8, phase: 16, wheels: 88, angles: 204, velocities: 58, gap: 10 };

/** Charts of one run on a canvas, with a cursor over them. */
class Traces {
  constructor(place, robot) {
    this.place = place;
    this.canvas = place.querySelector("canvas");
    this.cursor = place.querySelector(".cursor");
    this.robot = robot;
  }

  /** Draws everything but the cursor; span is the time that the width stands for. */
  draw(run, target, span, colours) {
    const { context, width } = freshContext(this.canvas);
    Object.assign(this, { run, span, colours, context, width });
    context.font = "11px system-ui, sans-serif";
    context.textBaseline = "middle";
    let top = 0;
    this.phases(top);
    top += TRACES.phase;
    this.wheels(top);
    top += TRACES.wheels + TRACES.gap;
    this.angles(top, target);
    top += TRACES.angles + TRACES.gap;
    this.velocities(top);
    this.clock(top + TRACES.velocities);
  }

  /** Says whose run it is, where it doesn't stand below its robot. */
  name(policy) {
    this.place.querySelector(".of").textContent = policy;
  }

  x(time) {
    return TRACES.left + ((this.width - TRACES.left - TRACES.right) * time) / this.span;
  }

  timeAt(x) {
    const share = (x - TRACES.left) / (this.width - TRACES.left - TRACES.right);
    return Math.min(1, Math.max(0, share)) * this.span;
  }

  seek(time) {
    this.cursor.style.transform = `translateX(${this.x(time)}px)`;
  }

  text(words, x, y, colour, align = "right") {
    this.context.fillStyle = colour;
    this.context.textAlign = align;
    this.context.fillText(words, x, y);
  }

  level(y, colour, dash = []) {
    const { context } = this;
    context.beginPath();
    context.moveTo(TRACES.left, y);
    context.lineTo(this.width - TRACES.right, y);
    context.strokeStyle = colour;
    context.lineWidth = 1;
    context.setLineDash(dash);
    context.stroke();
    context.setLineDash([]);
  }

  /** The span of an interval; one that a violation cut short ends with the run. */
  interval(k) {
    const start = k * this.robot.delta_t;
    return [start, Math.min(start + this.robot.delta_t, this.run.end)];
  }

  /** Numbers of the phases, the longest first: where there is no room the short ones do without. */
  phases(top) {
    this.text("phase", TRACES.left - 4, top + 7, this.colours.soft);
    const { phases } = this.run;
    const starts = phases.map((_, k) => k).filter((k) => phases[k] !== phases[k - 1]);
    const spans = starts.map((k, which) => [k, (starts[which + 1] ?? phases.length) - k]);
    const taken = [];
    for (const [k] of spans.sort((a, b) => b[1] - a[1])) {
      const x = this.x(this.interval(k)[0]);
      if (taken.some((other) => Math.abs(other - x) < 16)) continue;
      this.text(String(phases[k]), x + 3, top + 7, this.colours.ink, "left");
      taken.push(x);
    }
  }

  wheels(top) {
    const height = TRACES.wheels / this.robot.n_joints;
    const { context, colours, run } = this;
    for (let wheel = 1; wheel <= this.robot.n_joints; wheel++) {
      const y = top + height * (wheel - 1);
      if (wheel === 1 || wheel === this.robot.n_joints) {
        this.text(`w${wheel}`, TRACES.left - 6, y + height / 2, colours.soft);
      }
      run.phases.forEach((phase, k) => {
        const [start, stop] = this.interval(k);
        const up = run.isLifted(k, wheel);
        context.fillStyle = phase === wheel ? colours.ink : up ? colours.lifted : colours.support;
        context.globalAlpha = phase === wheel ? 1 : up ? 0.85 : 0.35;
        context.fillRect(this.x(start), y + 1, this.x(stop) - this.x(start) - 0.7, height - 2);
        context.globalAlpha = 1;
      });
    }
  }

  /** A lane per joint from limit to limit, with the target dotted and the phase's joint shaded. */
  angles(top, target) {
    const { context, colours, robot, run } = this;
    const n = robot.n_joints;
    const height = TRACES.angles / n;
    for (let k = 0; k < n; k++) {
      const middle = top + height * (k + 0.5);
      const y = (angle) => middle - ((height / 2 - 1.5) * angle) / robot.phi_limit;
      run.phases.forEach((phase, interval) => {
        if (phase !== k + 1) return;
        const [start, stop] = this.interval(interval);
        context.fillStyle = colours.ink;
        context.globalAlpha = 0.09;
        context.fillRect(this.x(start), middle - height / 2, this.x(stop) - this.x(start), height);
        context.globalAlpha = 1;
      });
      this.level(top + height * k, colours.rule);
      this.level(y(target[k]), colours.target, [2, 3]);
      this.text(`\u03c6${k + 1}`, TRACES.left - 6, middle, colours.soft);
      this.curve((frame) => y(run.phi[frame * n + k]), colours.ink, 1.4);
    }
    this.level(top + TRACES.angles, colours.rule);
  }

  /** All joint velocities over one another; the phase's joint stands out. */
  velocities(top) {
    const { colours, robot, run } = this;
    const n = robot.n_joints;
    const middle = top + TRACES.velocities / 2;
    const room = TRACES.velocities / 2 - 3;
    const y = (speed) => middle - (room * speed) / robot.u_limit;
    this.level(middle, colours.rule);
    for (const sign of [-1, 1]) this.level(y(sign * robot.u_limit), colours.soft, [4, 4]);
    this.text("u", TRACES.left - 6, middle, colours.soft);
    const speed = (frame, k) => {
      const one = Math.min(frame, run.frames - 2);
      const span = run.timeOf(one + 1) - run.timeOf(one);
      return span > 0 ? (run.phi[(one + 1) * n + k] - run.phi[one * n + k]) / span : 0;
    };
    if (run.frames < 2) return;
    this.context.globalAlpha = 0.5;
    for (let k = 0; k < n; k++) this.curve((frame) => y(speed(frame, k)), colours.soft, 1);
    this.context.globalAlpha = 1;
    const scp = (frame) => run.phases[run.interval(run.timeOf(frame))];
    if (run.phases.length) {
      this.curve((frame) => y(speed(frame, scp(frame) - 1)), colours.accent, 1.4);
    }
  }

  curve(y, colour, width) {
    const { context, run } = this;
    context.beginPath();
    for (let frame = 0; frame < run.frames; frame++) {
      context.lineTo(this.x(run.timeOf(frame)), y(frame));
    }
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.lineJoin = "round";
    context.stroke();
  }

  /** Round times along the bottom. */
  clock(top) {
    const room = Math.max(2, Math.floor((this.width - TRACES.left) / 64));
    const step = [1, 2, 5, 10, 20, 30, 60, 120].find((s) => this.span / s <= room) || 300;
    for (let time = 0; time <= this.span; time += step) {
      const right = this.x(time) > this.width - 14;
      const words = time ? String(time) : "0 s";
      this.text(words, this.x(time), top + 11, this.colours.soft, right ? "right" : "center");
    }
  }
}
