// The panel of the chosen agent: its action and the explanation.

class AgentPanel {
  constructor(run, page) {
    Object.assign(this, { run, page, data: run.data, now: page.now });
  }

  fill() {
    const { data, now: { tick, agent } } = this;
    // Parts that the reader opened stay open from tick to tick.
    const open = new Set([...$("agent").querySelectorAll("details[open]")].map((details) => details.dataset.part));
    if (agent < 0) {
      const list = data.agents.map(({ id }, index) => make("li", {}, this.agentLink(index, id), ` ${this.run.action(tick, index)}`));
      $("agent").replaceChildren(
        make("h2", {}, "Click an agent to see why it acts as it does"),
        make("ul", { class: "tree" }, ...list));
      return;
    }
    const { id, kind, concepts, priority } = data.agents[agent];
    const { at, heading, goal, derived, why, action } = data.ticks[tick];
    const done = data.actions[action[agent]];
    const driven = this.run.driven(tick, agent);
    const judged = this.run.byRules(tick, agent);
    const by = this.run.causes(tick, agent);
    const bits = data.actions.filter((_, index) => derived[agent] >> index & 1);
    const head = make("div", { class: "card-head" },
      make("h2", {}, id),
      make("span", { class: "badge", id: "action", style: `background:${COLORS[done]}` }, done),
      ...[kind, ...concepts].map((word) => make("span", { class: "chip" }, word)),
      driven && make("span", { class: "chip driven" }, "driven"),
      make("button", { type: "button", title: "clear the selection (Esc)", onclick: () => this.page.choose({ agent: -1 }) }, "×"));
    const direction = heading[agent] < 0 ? "has not moved yet" : `heading ${data.headings[heading[agent]]}`;
    const facts = make("dl", { class: "facts" },
      make("dt", {}, "at"), make("dd", {}, `[${at[agent]}], ${direction}`),
      make("dt", {}, "goal"), make("dd", {}, `[${goal[agent]}]`),
      make("dt", {}, "priority"), make("dd", {}, String(priority)),
      ...(driven ? this.steering(driven) : [make("dt", {}, "because"), make("dd", {}, by || "no clause fired")]));
    if (bits.length > 1) facts.append(make("dt", {}, "derived"), make("dd", {}, `${bits.join(", ")}; the rules prefer ${data.actions[judged]}`));
    const question = driven ? `Why do the rules want ${data.actions[judged]}?` : `Why ${done}?`;
    const parts = [head, facts, make("h3", {}, question), this.tree(why[agent][judged])];
    data.actions.forEach((other, index) => {
      if (index === judged || why[agent][index] < 0) return;
      const question = bits.includes(other) ? `${other} was derived too: why?` : `Why not ${other}?`;
      parts.push(this.part(`why-${other}`, question, open, () => [this.tree(why[agent][index])]));
    });
    parts.push(this.part("atoms", "True atoms", open, () => this.atoms(tick, agent)));
    $("agent").replaceChildren(...parts);
  }

  /** Shows what a driven agent observed, and the clauses that its action violated. Proofs cover all agents in view. */
  steering({ observes, wanted, broken, agent, tick }) {
    const { data } = this;
    const others = observes.filter((other) => other !== agent).flatMap((other) => [this.agentLink(other), " "]);
    const node = data.nodes[data.ticks[tick].why[agent][wanted]];
    const judged = broken.map((clause) => make("div", { class: "no" }, "violated ", this.clauseLink(clause)));
    return [
      make("dt", {}, "observes"), make("dd", {}, ...(others.length ? others : ["no other agent"])),
      make("dt", {}, "rules want"), make("dd", { id: "wanted" }, data.actions[wanted],
        node && node.t === undefined ? "; given all agents in view, the rules want another action" : ""),
      make("dt", {}, "judged"), make("dd", { id: "judged" }, ...(judged.length ? judged : ["no clause violated"])),
    ];
  }

  /** Returns a section whose content is created when the reader opens it. */
  part(name, title, open, content) {
    const details = make("details", { "data-part": name, open: open.has(name) }, make("summary", {}, title));
    const fill = () => { if (details.open && details.childElementCount === 1) details.append(...content()); };
    details.addEventListener("toggle", fill);
    fill();
    return details;
  }

  agentLink(agent, text = this.data.agents[agent].id) {
    const link = make("button", { type: "button", class: "agent-link", onclick: () => this.page.choose({ agent }) }, text);
    const hover = (which) => () => { this.now.hover = which; this.page.draw(); };
    for (const [name, which] of [["mouseenter", agent], ["focus", agent], ["mouseleave", -1], ["blur", -1]]) link.addEventListener(name, hover(which));
    return link;
  }

  /** Returns a text in which agent names are links. */
  linked(text) {
    return text.split(/([\w.-]+)/).map((word) => (this.run.names.has(word) && this.run.names.get(word) !== this.now.agent ? this.agentLink(this.run.names.get(word)) : word));
  }

  clauseLink(clause) {
    const { doc, file, line, text } = this.data.clauses[clause];
    return make("span", { class: "clause", title: text }, `${(doc || text).split("\n")[0]}  [${file.split(/[\\/]/).pop()}:${line}]`);
  }

  /** Returns the proof of a node, or why it does not hold. Expands each node only once. */
  tree(number) {
    const list = make("ul", { class: "tree" });
    if (number >= 0) list.append(this.branch(number, this.data.nodes[number].t ?? this.data.nodes[number].f, new Set()));
    return list;
  }

  branch(number, text, expanded) {
    const node = this.data.nodes[number];
    const item = make("li", {});
    if (node.t !== undefined) {
      item.append(make("span", { class: "yes" }, ...this.linked(text)));
      if (node.c === undefined) return item;
      item.append(" by ", this.clauseLink(node.c));
      if (expanded.has(number)) return item;
      expanded.add(number);
      item.append(make("ul", {}, ...node.p.map((premise) => this.premise(premise, expanded))));
      return item;
    }
    item.append(make("span", { class: "no" }, ...this.linked(text)));
    if (node.by === "not-looked-into") item.append(" (not explained further)");
    if (!node.m || expanded.has(number)) return item;
    expanded.add(number);
    item.append(this.misses(node.m, expanded));
    return item;
  }

  /** Returns a literal that holds. */
  premise([text, kind, child], expanded) {
    if (child < 0) return make("li", {}, make("span", { class: "yes" }, ...this.linked(text)));
    const node = this.data.nodes[child];
    if (kind !== "not") return this.branch(child, text, expanded);
    const item = make("li", {}, make("span", { class: "yes" }, ...this.linked(text)));
    if (node.m && !expanded.has(child)) {
      expanded.add(child);
      item.append(make("details", {}, make("summary", {}, "no clause derives it"), this.misses(node.m, expanded)));
    }
    return item;
  }

  /** Returns for each clause the literals that fail. */
  misses(misses, expanded) {
    return make("ul", {}, ...misses.map(([clause, binding, fails]) => {
      const nearest = Object.entries(binding).filter(([, name]) => this.run.names.get(name) !== this.now.agent);
      const item = make("li", {}, this.clauseLink(clause));
      if (nearest.length) item.append(" nearest ", ...this.linked(nearest.map(([variable, name]) => `${variable} = ${name}`).join(", ")));
      const failures = fails.map(([text, kind, child]) => {
        const say = kind === "not" ? " fails" : kind === "in-view" ? " is not in view" : kind === "fact" ? " does not hold" : " is false";
        const failure = make("li", {}, make("span", { class: "no" }, ...this.linked(text)), say);
        const node = child < 0 ? undefined : this.data.nodes[child];
        if (node && (node.c !== undefined || node.m) && !expanded.has(child)) failure.append(make("ul", {}, this.branch(child, node.t ?? node.f, expanded)));
        return failure;
      });
      if (!fails.length) failures.push(make("li", {}, "its head does not match"));
      item.append(make("ul", {}, ...failures));
      return item;
    }));
  }

  /** Returns the atoms that are true of an agent and of the agents it sees, as the rules read them. */
  atoms(tick, agent) {
    const { predicates, agents } = this.data;
    const rows = this.run.facts[tick];
    const sees = predicates.findIndex(({ name }) => name === "Sees");
    const seen = new Set([agent]);
    for (let at = 0; at < rows[sees].length; at += 2) if (rows[sees][at] === agent) seen.add(rows[sees][at + 1]);
    const of = new Map([...seen].map((one) => [one, []]));
    predicates.forEach(({ name, arity }, predicate) => {
      const flat = rows[predicate];
      for (let at = 0; at < flat.length; at += arity) {
        const row = flat.slice(at, at + arity);
        if (row.some((one) => !seen.has(one)) || (arity === 2 && row[0] === row[1])) continue;
        of.get(row[0]).push(`${name}(${row.map((one) => agents[one].id).join(", ")})`);
      }
    });
    return [...of].map(([one, atoms]) => make("div", {}, this.agentLink(one), make("p", { class: "atoms" }, ...this.linked(atoms.join(", ")))));
  }
}
