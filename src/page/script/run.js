// A run: what the map and the panel compute from its ticks.

/** What the map and the panel read of a run. A subclass holds the ticks and has the methods `at`, `goal`, `act`,
 *  `heading`, `bits`, `fired`, `box`, `progress`, `isExplained`, `node`, `rows` and `values`, and the list
 *  `nodes`. */
class Run {
  constructor(data) {
    this.data = data;
    colorActions(data.actions);
    this.agents = data.agents.length;
    this.names = new Map(data.agents.map((agent, index) => [agent.id, index]));
    /** The steps of driven agents, by tick. */
    this.steered = Map.groupBy(data.driven ?? [], ({ tick }) => tick);
    /** What the examples say about learned clauses, by label. */
    this.support = new Map(data.learned?.clauses.map((clause) => [clause.label, clause]));
  }

  action(tick, agent) {
    return this.data.actions[this.act(tick, agent)];
  }

  /** Returns where an agent faces: its heading, or along its route before the first move. */
  facing(tick, agent) {
    const shown = Math.min(tick, this.count - 1);
    const heading = this.heading(shown, agent);
    if (heading) return heading;
    const [start, next] = this.progress(shown, agent).corners;
    if (!next) return "Up";
    if (start[0] !== next[0]) return start[0] > next[0] ? "Up" : "Down";
    return start[1] > next[1] ? "Left" : "Right";
  }

  /** Returns the names of the actions that were derived before the default. */
  derived(tick, agent) {
    const bits = this.bits(tick, agent);
    return this.data.actions.filter((_, index) => (bits >> index) & 1);
  }

  /** Returns first and last cell of a field of view. */
  view(tick, agent) {
    const [row, col] = this.at(tick, agent);
    const [top, left, bottom, right] = this.box(tick, agent);
    return [row + top, col + left, row + bottom, col + right];
  }

  /** Returns the quantities that an agent reads in a tick, as [name, value, other agent or `undefined`]: its own, those
   *  of the city, and those of it and an agent that it sees. */
  quantities(tick, agent) {
    const found = [];
    for (const [predicate, rows] of this.values(tick)) {
      const { name, arity } = this.data.predicates[predicate];
      for (const [row, value] of rows) {
        const [first, second] = arity === 2 ? [Math.floor(row / this.agents), row % this.agents] : [row];
        if (arity === 0 || first === agent) found.push([name, value, second]);
      }
    }
    return found;
  }

  label(clause) {
    return this.data.clauses[clause].label;
  }

  /** Returns the label and the body of a learned clause, and the first line of the comment of another one, or else its
   *  label. */
  title(clause) {
    const support = this.support.get(this.label(clause));
    if (support) return `${support.label}: ${support.body.join(", ") || "true"}`;
    return (this.data.clauses[clause].doc || this.label(clause)).split("\n")[0];
  }

  /** Returns the rest of an agent's route, as points [row, column]. */
  wayAhead(tick, agent) {
    const { corners, gone } = this.progress(tick, agent);
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

  /** Returns the action to explain first: the one taken, or the one that the rules wanted for a driven agent, or the one
   *  that learned rules choose. */
  byRules(tick, agent) {
    return this.driven(tick, agent)?.wanted ?? this.learnedAction(tick, agent) ?? this.act(tick, agent);
  }

  /** Returns the action that learned rules choose; `undefined` if the rules are not learned. */
  learnedAction(tick, agent) {
    const { learned, actions } = this.data;
    return learned && actions.indexOf(this.derived(tick, agent)[0] ?? learned.default);
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

/** Enlarges a rectangle so that it contains a cell. */
function extend(bounds, [row, col]) {
  bounds[0] = Math.min(bounds[0], row);
  bounds[1] = Math.min(bounds[1], col);
  bounds[2] = Math.max(bounds[2], row);
  bounds[3] = Math.max(bounds[3], col);
}
