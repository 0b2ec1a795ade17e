// A run whose ticks are in the page.

class RecordedRun extends Run {
  constructor(data) {
    super(data);
    this.count = data.count;
    this.nodes = [];
    /** The number of ticks with explanations so far. */
    this.explained = 0;
    /** For each tick with explanations, the node of each agent and action. */
    this.why = [];
    /** For each tick, the rows that appear or disappear. */
    this.changes = [];
    /** For each tick, the quantities with their rows and values. */
    this.measured = [];
    this.shown = { tick: -1, rows: data.predicates.map(() => new Set()) };
    this.firings = new Map();
    this.covered = new Map();
    this.unfold();
  }

  /** Restores the cells and goals of every tick. */
  unfold() {
    const { at, goal, last } = this.data;
    const wide = 2 * this.agents;
    this.cells = new Int32Array((this.count + 1) * wide);
    this.goals = new Int32Array(this.count * wide);
    for (let agent = 0; agent < this.agents; agent += 1) {
      let [row, col] = [0, 0];
      for (let tick = 0; tick < this.count; tick += 1) {
        row += at[agent][2 * tick];
        col += at[agent][2 * tick + 1];
        this.cells.set([row, col], tick * wide + 2 * agent);
      }
      this.cells.set(last[agent], this.count * wide + 2 * agent);
      goal[agent].forEach(([since, ...cell], number) => {
        const until = goal[agent][number + 1]?.[0] ?? this.count;
        for (let tick = since; tick < until; tick += 1) this.goals.set(cell, tick * wide + 2 * agent);
      });
    }
  }

  /** Adds explanations and facts of the next ticks. */
  add({ nodes, why, facts, values = [] }) {
    for (const node of nodes) this.nodes.push(node);
    for (const changes of why) {
      const before = this.why.at(-1);
      this.why.push(Int32Array.from(changes, (change, at) => change + (before ? before[at] : 0)));
    }
    for (const change of facts) this.changes.push(change);
    for (const quantities of values) this.measured.push(quantities);
    this.explained = this.why.length;
  }

  /** Returns the rows of every predicate in a tick, as sets of numbers. A change undoes itself when repeated. */
  rows(tick) {
    const { shown } = this;
    const toggle = ([predicate, ...steps]) => {
      let row = 0;
      for (const step of steps) {
        row += step;
        if (!shown.rows[predicate].delete(row)) shown.rows[predicate].add(row);
      }
    };
    while (shown.tick < tick) this.changes[(shown.tick += 1)].forEach(toggle);
    while (shown.tick > tick) this.changes[(shown.tick -= 1) + 1].forEach(toggle);
    return shown.rows;
  }

  /** Returns the quantities of a tick, each as [position among the predicates, [row, value] ...]. */
  values(tick) {
    return this.measured[tick] ?? [];
  }

  at(tick, agent) {
    const place = 2 * (tick * this.agents + agent);
    return [this.cells[place], this.cells[place + 1]];
  }

  goal(tick, agent) {
    const place = 2 * (tick * this.agents + agent);
    return [this.goals[place], this.goals[place + 1]];
  }

  /** Returns the position of the action that an agent takes. */
  act(tick, agent) {
    return parseInt(this.data.action[agent][tick], 16);
  }

  /** Returns the heading of an agent; `undefined` before its first move. */
  heading(tick, agent) {
    return this.data.headings[this.data.heading[agent][tick]];
  }

  /** Returns the actions that were derived before the default, as a bit set. */
  bits(tick, agent) {
    const width = Math.ceil(this.data.actions.length / 4);
    return parseInt(this.data.derived[agent].slice(width * tick, width * (tick + 1)), 16);
  }

  /** Returns the clauses that fired for an agent. */
  fired(tick, agent) {
    return this.data.fired_sets[this.data.fired[agent][tick]];
  }

  /** Returns first and last cell of a field of view, relative to the agent. */
  box(tick, agent) {
    return this.data.views[this.data.view[agent][tick]];
  }

  /** Returns whether the explanations of a tick have arrived. */
  isExplained(tick) {
    return tick < this.explained;
  }

  /** Returns the number of the node that explains an action, or -1. */
  node(tick, agent, action) {
    return this.why[tick]?.[this.data.actions.length * agent + action] ?? -1;
  }

  /** Returns the [tick, agent] of the firings of a clause, in order. */
  firingsOf(clause) {
    if (!this.firings.has(clause)) {
      const sets = this.data.fired_sets.map((set) => set.includes(clause));
      const found = [];
      for (let tick = 0; tick < this.count; tick += 1) {
        for (let agent = 0; agent < this.agents; agent += 1)
          if (sets[this.data.fired[agent][tick]]) found.push([tick, agent]);
      }
      this.firings.set(clause, found);
    }
    return this.firings.get(clause);
  }

  /** Returns the corners of an agent's route, and the number of cells it has covered. */
  progress(tick, agent) {
    if (!this.covered.has(agent)) {
      const routes = this.data.routes[agent];
      let route = -1,
        gone = 0;
      const steps = Array.from({ length: this.count }, (_, tick) => {
        if (route + 1 < routes.length && routes[route + 1][0] === tick) {
          route += 1;
          gone = 0;
        }
        const here = { corners: route < 0 ? [] : routes[route][1], gone };
        const [from, to] = [this.at(tick, agent), this.at(tick + 1, agent)];
        gone += Math.abs(to[0] - from[0]) + Math.abs(to[1] - from[1]);
        return here;
      });
      this.covered.set(agent, steps);
    }
    return this.covered.get(agent)[tick];
  }

  /** Returns the rectangle of cells that agents visit. */
  bounds() {
    const bounds = [Infinity, Infinity, -Infinity, -Infinity];
    for (let at = 0; at < this.cells.length; at += 2) extend(bounds, [this.cells[at], this.cells[at + 1]]);
    return bounds;
  }
}
