// A run: what the page computes from its data.

class Run {
  constructor(data) {
    this.data = data;
    this.count = data.count;
    this.agents = data.agents.length;
    this.names = new Map(data.agents.map((agent, index) => [agent.id, index]));
    this.nodes = [];
    /** The number of ticks with explanations so far. */
    this.explained = 0;
    /** For each tick with explanations, the node of each agent and action. */
    this.why = [];
    /** For each tick, the rows that appear or disappear. */
    this.changes = [];
    this.shown = { tick: -1, rows: data.predicates.map(() => new Set()) };
    this.firings = new Map();
    this.progress = new Map();
    this.unfold();
    /** The steps of driven agents, by tick. */
    this.steered = Map.groupBy(data.driven ?? [], ({ tick }) => tick);
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
  add({ nodes, why, facts }) {
    for (const node of nodes) this.nodes.push(node);
    for (const changes of why) {
      const before = this.why.at(-1);
      this.why.push(Int32Array.from(changes, (change, at) => change + (before ? before[at] : 0)));
    }
    for (const change of facts) this.changes.push(change);
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
    return Number(this.data.action[agent][tick]);
  }

  action(tick, agent) {
    return this.data.actions[this.act(tick, agent)];
  }

  /** Returns the heading of an agent; `undefined` before its first move. */
  heading(tick, agent) {
    return this.data.headings[this.data.heading[agent][tick]];
  }

  /** Returns where an agent faces: its heading, or along its route before the first move. */
  facing(tick, agent) {
    const heading = this.heading(Math.min(tick, this.count - 1), agent);
    if (heading) return heading;
    const [start, next] = this.data.routes[agent][0]?.[1] ?? [];
    if (!next) return "Up";
    if (start[0] !== next[0]) return start[0] > next[0] ? "Up" : "Down";
    return start[1] > next[1] ? "Left" : "Right";
  }

  /** Returns the names of the actions that were derived before the default. */
  derived(tick, agent) {
    const bits = parseInt(this.data.derived[agent][tick], 16);
    return this.data.actions.filter((_, index) => (bits >> index) & 1);
  }

  /** Returns the clauses that fired for an agent. */
  fired(tick, agent) {
    return this.data.fired_sets[this.data.fired[agent][tick]];
  }

  /** Returns first and last cell of a field of view. */
  view(tick, agent) {
    const [row, col] = this.at(tick, agent);
    const [top, left, bottom, right] = this.data.views[this.data.view[agent][tick]];
    return [row + top, col + left, row + bottom, col + right];
  }

  /** Returns the number of the node that explains an action, or -1. */
  node(tick, agent, action) {
    return this.why[tick]?.[4 * agent + action] ?? -1;
  }

  label(clause) {
    return this.data.clauses[clause].label;
  }

  /** Returns the first line of a clause's comment, or its label. */
  title(clause) {
    return (this.data.clauses[clause].doc || this.label(clause)).split("\n")[0];
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

  /** Returns for every tick the route of an agent, and the number of cells it has covered. */
  progressOf(agent) {
    if (!this.progress.has(agent)) {
      const routes = this.data.routes[agent];
      let route = -1,
        gone = 0;
      const steps = Array.from({ length: this.count }, (_, tick) => {
        if (route + 1 < routes.length && routes[route + 1][0] === tick) {
          route += 1;
          gone = 0;
        }
        const here = { route, gone };
        const [from, to] = [this.at(tick, agent), this.at(tick + 1, agent)];
        gone += Math.abs(to[0] - from[0]) + Math.abs(to[1] - from[1]);
        return here;
      });
      this.progress.set(agent, steps);
    }
    return this.progress.get(agent);
  }

  /** Returns the rest of an agent's route, as points [row, column]. */
  wayAhead(tick, agent) {
    const { route, gone } = this.progressOf(agent)[tick];
    const corners = route < 0 ? [] : this.data.routes[agent][route][1];
    let left = gone;
    for (let at = 0; at + 1 < corners.length; at += 1) {
      const [a, b] = [corners[at], corners[at + 1]];
      const length = Math.abs(b[0] - a[0]) + Math.abs(b[1] - a[1]);
      if (left < length) return [this.at(tick, agent), ...corners.slice(at + 1)];
      left -= length;
    }
    return [];
  }

  /** Returns the step of a driven agent in a tick; `undefined` for other agents. */
  driven(tick, agent) {
    return this.steered.get(tick)?.find((one) => one.agent === agent);
  }

  /** Returns the action to explain first: the one taken, or for a driven agent the one that the rules wanted. */
  byRules(tick, agent) {
    return this.driven(tick, agent)?.wanted ?? this.act(tick, agent);
  }

  /** Returns the titles of the clauses that fired for an agent. */
  causes(tick, agent) {
    return this.fired(tick, agent)
      .map((clause) => this.title(clause))
      .join("; ");
  }

  /** Returns the other agents in the proof of the action. */
  partners(tick, agent) {
    const node = this.nodes[this.node(tick, agent, this.byRules(tick, agent))];
    const named = Object.values(node?.b ?? {}).map((name) => this.names.get(name));
    return [...new Set(named.filter((other) => other !== undefined && other !== agent))];
  }
}
