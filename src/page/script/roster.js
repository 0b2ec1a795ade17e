// The agents that lists, timeline and map show: those that match a filter, in groups of a kind.

/** Returns the kind of an agent: the word in its name, such as `Car` or a kind that the configuration defines. */
function groupOf({ id, kind }) {
  return /^(.+)_\d+$/.exec(id)?.[1] ?? kind;
}

class Roster {
  constructor(page) {
    this.page = page;
    /** The filter: words of a name, a kind, and an action; an empty text matches all. */
    this.filter = { words: "", kind: "", action: "" };
    /** The kinds whose agents the timeline hides. */
    this.closed = new Set();
  }

  get isFiltered() {
    return Object.values(this.filter).some((text) => text.trim());
  }

  /** Returns whether an agent matches the filter in a tick. */
  has(agent, tick) {
    const { words, kind, action } = this.filter;
    const { runs, run } = this.page;
    const found = run.data.agents[agent];
    if (kind && groupOf(found) !== kind) return false;
    if (action && !runs.some((one) => one.action(tick, agent) === action)) return false;
    const text = [found.id, ...found.concepts].join(" ").toLowerCase();
    return words
      .toLowerCase()
      .split(/\s+/)
      .every((word) => text.includes(word));
  }

  /** Returns the kinds of the run with all of their agents, in the order of the agents. */
  kinds() {
    return Map.groupBy(
      this.page.run.data.agents.map((_, agent) => agent),
      (agent) => groupOf(this.page.run.data.agents[agent]),
    );
  }

  /** Returns the groups with agents that match in a tick. */
  groups(tick) {
    const groups = [...this.kinds()].map(([name, all]) => ({
      name,
      total: all.length,
      agents: all.filter((agent) => this.has(agent, tick)),
    }));
    return groups.filter(({ agents }) => agents.length);
  }

  /** Returns the agents that match in a tick, in the order in which lists show them. */
  agents(tick) {
    return this.groups(tick).flatMap(({ agents }) => agents);
  }

  /** Returns how many of the agents of a group match, as `10`, or `3 of 10`. */
  count({ agents, total }) {
    return agents.length === total ? `${total}` : `${agents.length} of ${total}`;
  }
}

/** The fields of the filter. */
class Finder {
  constructor(page) {
    Object.assign(this, { page, roster: page.roster });
    const { run, roster } = page;
    const option = (value, text = value) => make("option", { value }, text);
    const kinds = [...roster.kinds()].map(([name, agents]) => option(name, `${name} (${agents.length})`));
    $("find-kind").append(option("", "every kind"), ...kinds);
    $("find-action").append(option("", "any action"), ...run.data.actions.map((action) => option(action)));
    for (const [id, key, event] of [
      ["find-name", "words", "input"],
      ["find-kind", "kind", "change"],
      ["find-action", "action", "change"],
    ])
      $(id).addEventListener(event, () => this.set({ [key]: $(id).value }));
    page.press("find-all", () => this.clear());
    $("find-name").addEventListener("keydown", (event) => {
      if (event.key !== "Escape") return;
      this.clear();
      event.target.blur();
      event.stopPropagation();
    });
  }

  /** Changes the filter. */
  set(filter) {
    Object.assign(this.roster.filter, filter);
    this.page.refresh();
  }

  clear() {
    for (const id of ["find-name", "find-kind", "find-action"]) $(id).value = "";
    this.set({ words: "", kind: "", action: "" });
  }

  /** Shows the number of agents that match in a tick. */
  fill(tick) {
    const { roster, page } = this;
    $("find-all").hidden = !roster.isFiltered;
    $("found").textContent = roster.isFiltered ? `${roster.agents(tick).length} of ${page.run.agents} agents` : "";
  }
}
