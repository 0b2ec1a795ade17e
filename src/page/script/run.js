"use strict";

// The data of a run, and what the page computes from them.

/** Decodes base 64. */
function bytesOf(text) {
  return Uint8Array.from(atob(text.trim()), (letter) => letter.charCodeAt(0));
}

/** Decodes base 64, decompresses, and parses JSON. */
async function unpack(text) {
  const stream = new Blob([bytesOf(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return JSON.parse(await new Response(stream).text());
}

class Run {
  constructor(data) {
    this.data = data;
    this.count = data.ticks.length;
    this.names = new Map(data.agents.map((agent, index) => [agent.id, index]));
    this.facts = this.unfoldFacts();
    this.firings = this.collectFirings();
    this.progress = this.measureProgress();
    /** The steps of driven agents, by tick. */
    this.steered = Map.groupBy(data.driven ?? [], ({ tick }) => tick);
  }

  /** Returns for every tick the rows of every predicate. Ticks without a change share them. */
  unfoldFacts() {
    let rows = this.data.predicates.map(() => []);
    return this.data.ticks.map(({ facts }) => {
      if (facts.length) rows = rows.slice();
      for (const [predicate, flat] of facts) rows[predicate] = flat;
      return rows;
    });
  }

  /** Returns for every clause the [tick, agent] of its firings, in order. */
  collectFirings() {
    const firings = this.data.clauses.map(() => []);
    this.data.ticks.forEach(({ fired }, tick) => {
      fired.forEach((clauses, agent) => clauses.forEach((clause) => firings[clause].push([tick, agent])));
    });
    return firings;
  }

  /** Returns for every agent and tick its route, and the number of cells it has covered. */
  measureProgress() {
    return this.data.agents.map((_, agent) => {
      const routes = this.data.routes[agent];
      let route = -1, gone = 0;
      return this.data.ticks.map(({ at }, tick) => {
        if (route + 1 < routes.length && routes[route + 1][0] === tick) {
          route += 1;
          gone = 0;
        }
        const here = { route, gone };
        const next = this.at(tick + 1, agent);
        gone += Math.abs(next[0] - at[agent][0]) + Math.abs(next[1] - at[agent][1]);
        return here;
      });
    });
  }

  at(tick, agent) {
    return tick < this.count ? this.data.ticks[tick].at[agent] : this.data.last[agent];
  }

  action(tick, agent) {
    return this.data.actions[this.data.ticks[tick].action[agent]];
  }

  label(clause) {
    return this.data.clauses[clause].label;
  }

  /** Returns the first line of a clause's comment, or its label. */
  title(clause) {
    return (this.data.clauses[clause].doc || this.label(clause)).split("\n")[0];
  }

  /** Returns the rest of an agent's route, as points [row, column]. */
  wayAhead(tick, agent) {
    const { route, gone } = this.progress[agent][tick];
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
    return this.driven(tick, agent)?.wanted ?? this.data.ticks[tick].action[agent];
  }

  /** Returns the titles of the clauses that fired for an agent. */
  causes(tick, agent) {
    return this.data.ticks[tick].fired[agent].map((clause) => this.title(clause)).join("; ");
  }

  /** Returns the other agents in the proof of the action. */
  partners(tick, agent) {
    const node = this.data.nodes[this.data.ticks[tick].why[agent][this.byRules(tick, agent)]];
    const named = Object.values(node?.b ?? {}).map((name) => this.names.get(name));
    return [...new Set(named.filter((other) => other !== undefined && other !== agent))];
  }
}
