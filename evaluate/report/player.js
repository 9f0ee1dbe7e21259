// The replay: one clock, two runs of an episode, and everything that moves them.

const SPEEDS = [0.5, 1, 2, 4, 8];
const SEEK_S = 1; // what an arrow key is worth
const LEAD_S = 6; // what is seen before a violation

class Player {
  constructor(element, data) {
    this.element = element;
    this.robot = data.robot;
    this.policies = data.policies;
    this.episodes = data.episodes;
    this.time = 0;
    this.speed = 4;
    this.playing = false;
    this.decoded = new Map();
    this.sides = [...element.querySelectorAll("[data-side]")].map((place) => {
      const name = place.dataset.side;
      return {
        name,
        select: element.querySelector(`#${name}`),
        outcome: place.querySelector(".outcome"),
        status: place.querySelector(".status"),
        view: new RobotView(place.querySelector(".robot"), this.robot),
        traces: new Traces(element.querySelector(`[data-traces=${name}]`), this.robot),
      };
    });
    this.controls = {};
    for (const id of ["episode", "previous", "next", "play", "scrub", "time", "speed"]) {
      this.controls[id] = element.querySelector(`#${id}`);
    }
    this.fillChoices();
    this.listen();
    this.open(0);
  }

  fillChoices() {
    const groups = new Map();
    this.episodes.forEach((episode, k) => {
      if (!groups.has(episode.group)) {
        groups.set(episode.group, document.createElement("optgroup"));
        groups.get(episode.group).label = episode.group;
      }
      groups.get(episode.group).append(new Option(`${episode.name}: ${episode.why}`, k));
    });
    this.controls.episode.append(...groups.values());
    for (const side of this.sides) {
      side.select.append(...this.policies.map((name, k) => new Option(name, k)));
    }
    this.controls.speed.append(...SPEEDS.map((speed) => new Option(`${speed}\u00d7`, speed)));
    this.controls.speed.value = this.speed;
  }

  listen() {
    const { controls } = this;
    controls.episode.addEventListener("change", () => this.open(Number(controls.episode.value)));
    controls.previous.addEventListener("click", () => this.open(this.index - 1));
    controls.next.addEventListener("click", () => this.open(this.index + 1));
    controls.play.addEventListener("click", () => (this.playing ? this.pause() : this.play()));
    controls.scrub.addEventListener("input", () => this.seek(Number(controls.scrub.value)));
    controls.speed.addEventListener("change", () => (this.speed = Number(controls.speed.value)));
    for (const side of this.sides) {
      side.select.addEventListener("change", () => this.choose());
      const scrub = (event) => {
        const x = event.clientX - side.traces.canvas.getBoundingClientRect().left;
        this.seek(side.traces.timeAt(x));
      };
      side.traces.place.addEventListener("pointerdown", scrub);
      side.traces.place.addEventListener("pointermove", (event) => event.buttons && scrub(event));
    }
    this.element.addEventListener("keydown", (event) => this.key(event));
    new ResizeObserver(() => this.redraw()).observe(this.element);
  }

  /** Shows an episode, with the two policies that it is about. */
  open(index) {
    this.index = (index + this.episodes.length) % this.episodes.length;
    const episode = this.episodes[this.index];
    this.controls.episode.value = this.index;
    for (const side of this.sides) side.select.value = episode[side.name];
    this.time = this.begin = 0;
    this.choose();
    const failed = this.sides.find(({ select }) => Number(select.value) === episode.of);
    if (episode.group !== "Failures" || !failed?.run.violated) return;
    this.begin = Math.max(0, failed.run.end - LEAD_S);
    this.seek(this.begin);
  }

  /** Takes up the chosen policies' runs; the clock goes on where it is. */
  choose() {
    const episode = this.episodes[this.index];
    this.target = decodeAngles(episode.target, this.robot);
    for (const side of this.sides) side.run = this.decode(Number(side.select.value));
    const runs = this.sides.map((side) => side.run);
    this.span = Math.max(...runs.map((run) => run.end), this.robot.frame_s);
    this.box = boxOf(runs, this.target, this.robot);
    this.controls.scrub.max = this.span;
    for (const { run, outcome, select, traces } of this.sides) {
      outcome.textContent = this.ending(run);
      outcome.title = run.error;
      outcome.classList.toggle("failed", !run.solved);
      outcome.classList.toggle("neutral", run.skids);
      traces.name(this.policies[select.value]);
    }
    this.redraw();
  }

  /** How a run ended, in words. */
  ending(run) {
    const parts = [run.skids && run.solved ? "shape reached" : this.outcome(run)];
    if (run.w) {
      const [x, y] = run.at(run.end).w.map((value, k) => value - this.robot.w_d[k]);
      const off = Math.hypot(x, y);
      parts.push(`head ${off < 0.1 ? `${(1000 * off).toFixed(1)} mm` : `${off.toFixed(2)} m`} off`);
    }
    return [...parts, `${run.time.toFixed(1)} s`].join(", ");
  }

  outcome(run) {
    if (run.solved) return "target reached";
    const phase = run.phases.length ? ` in phase ${run.lastPhase}` : "";
    if (run.outcome === "joint_limit") {
      const angles = run.at(run.end).phi.map(Math.abs);
      return `joint ${1 + angles.indexOf(Math.max(...angles))} passed its limit${phase}`;
    }
    const still = run.outcome === "deadlock" && run.end < run.time;
    const since = still ? `: nothing moves after ${(run.end - this.robot.delta_t).toFixed(0)} s` : "";
    return (WHY[run.outcome] ?? run.outcome) + phase + since;
  }

  decode(policy) {
    const key = `${this.index} ${policy}`;
    if (!this.decoded.has(key)) {
      this.decoded.set(key, new Run(this.episodes[this.index].runs[policy], this.robot));
    }
    return this.decoded.get(key);
  }

  /** Draws everything, in the colours and sizes of now. */
  redraw() {
    this.colours = themeColours();
    for (const side of this.sides) {
      side.traces.draw(side.run, this.target, this.span, this.colours);
    }
    this.seek(this.time);
  }

  /** Sets the clock. */
  seek(time) {
    this.time = Math.min(Math.max(time, 0), this.span);
    this.controls.scrub.value = this.time;
    this.controls.scrub.setAttribute("aria-valuetext", `${this.time.toFixed(1)} seconds`);
    this.controls.time.textContent = `${this.time.toFixed(1)} / ${this.span.toFixed(1)} s`;
    for (const side of this.sides) this.show(side);
  }

  show({ run, view, traces, status }) {
    const over = this.time >= run.end;
    const interval = over && run.solved ? -1 : run.interval(this.time);
    view.draw(run, run.at(this.time), interval, this.target, this.box, this.colours);
    traces.seek(this.time);
    if (interval < 0) {
      status.textContent = over ? "all wheels on the ground" : "all joints turn at once";
      return;
    }
    const wheels = Array.from({ length: this.robot.n_joints }, (_, k) => k + 1);
    const up = wheels.filter((wheel) => run.isLifted(interval, wheel)).join(" ");
    const words = [`phase ${run.phases[interval]}`, `mode ${run.modes[interval]}`];
    status.textContent = [...words, `wheels lifted: ${up}`].join(", ");
  }

  play() {
    if (this.time >= this.span) this.seek(0);
    this.playing = true;
    this.button("Pause");
    let before = null;
    const tick = (now) => {
      if (!this.playing) return;
      if (before !== null) this.seek(this.time + ((now - before) / 1000) * this.speed);
      before = now;
      if (this.time >= this.span) this.pause();
      else requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  pause() {
    this.playing = false;
    this.button("Play");
  }

  button(label) {
    this.controls.play.setAttribute("aria-label", label);
    this.controls.play.classList.toggle("playing", this.playing);
  }

  accelerate(steps) {
    const index = SPEEDS.indexOf(this.speed) + steps;
    this.speed = SPEEDS[Math.min(Math.max(index, 0), SPEEDS.length - 1)];
    this.controls.speed.value = this.speed;
  }

  /** Keys work wherever the focus is in the player, but lists and buttons keep their own. */
  key(event) {
    const { tagName } = event.target;
    if (tagName === "SELECT" || event.ctrlKey || event.metaKey || event.altKey) return;
    if (tagName === "BUTTON" && event.key === " ") return;
    const actions = {
      " ": () => (this.playing ? this.pause() : this.play()),
      ArrowLeft: () => this.seek(this.time - SEEK_S),
      ArrowRight: () => this.seek(this.time + SEEK_S),
      Home: () => this.seek(0),
      End: () => this.seek(this.span),
      "+": () => this.accelerate(1),
      "-": () => this.accelerate(-1),
      n: () => this.open(this.index + 1),
      p: () => this.open(this.index - 1),
    };
    if (!actions[event.key]) return;
    event.preventDefault();
    actions[event.key]();
  }
}
/** Failures in words. */
const WHY = {
  stability: "tipped over: the centre of gravity left the support polygon",
  collision: "links touched",
  horizon: "out of time",
};
