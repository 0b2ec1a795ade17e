//! The probabilities of formulas as a function of those of their variables, with its gradient.

use crate::diagram::{Diagrams, Formula, Node};

/// The decisions on which some formulas depend, without the tables that made them.
#[derive(Clone, Debug)]
pub(crate) struct DiagramCircuit {
    /// Each after those that it reads; the first is the constant.
    nodes: Vec<Node>,
    /// The formulas.
    roots: Vec<Formula>,
    /// The variables of the diagrams that occur, in their order. Nodes have positions in this list.
    pub variables: Vec<u32>,
}

/// The probabilities of the nodes of a circuit: that each holds, and that it fails.
pub struct Values(Vec<[f64; 2]>);

impl Values {
    fn of(&self, formula: Formula) -> f64 {
        self.0[formula.node()][usize::from(formula.is_negated())]
    }
}

impl Diagrams {
    /// Returns the circuit of these formulas.
    pub fn circuit(&self, roots: &[Formula]) -> DiagramCircuit {
        let mut is_used = vec![false; self.nodes.len()];
        is_used[0] = true;
        roots.iter().for_each(|root| is_used[root.node()] = true);
        // A node is made after those that it reads.
        for at in (1..self.nodes.len()).rev() {
            if is_used[at] {
                is_used[self.nodes[at].holds.node()] = true;
                is_used[self.nodes[at].fails.node()] = true;
            }
        }
        let mut numbers = vec![0_u32; self.nodes.len()];
        let mut nodes: Vec<Node> = Vec::new();
        let mut variables: Vec<u32> = Vec::new();
        for (at, node) in self.nodes.iter().enumerate().filter(|(at, _)| is_used[*at]) {
            numbers[at] = nodes.len() as u32;
            let of = |formula: Formula| Formula::new(numbers[formula.node()], formula.is_negated());
            nodes.push(Node {
                variable: node.variable,
                holds: of(node.holds),
                fails: of(node.fails),
            });
            if at > 0 {
                variables.push(node.variable);
            }
        }
        variables.sort_unstable();
        variables.dedup();
        for node in nodes.iter_mut().skip(1) {
            let place = variables.binary_search(&node.variable).expect("it is listed");
            node.variable = place as u32;
        }
        let roots = roots
            .iter()
            .map(|root| Formula::new(numbers[root.node()], root.is_negated()));
        DiagramCircuit {
            roots: roots.collect(),
            nodes,
            variables,
        }
    }
}

impl DiagramCircuit {
    /// Returns the number of nodes.
    pub fn node_count(&self) -> usize {
        self.nodes.len()
    }

    /// Computes the probabilities of all nodes, given those of [`DiagramCircuit::variables`].
    pub fn values(&self, probabilities: &[f64]) -> Values {
        let mut values = Values(Vec::with_capacity(self.nodes.len()));
        values.0.push([1.0, 0.0]);
        for node in &self.nodes[1..] {
            let probability = probabilities[node.variable as usize];
            let of = |holds: Formula, fails: Formula| {
                probability * values.of(holds) + (1.0 - probability) * values.of(fails)
            };
            let each = [of(node.holds, node.fails), of(node.holds.not(), node.fails.not())];
            values.0.push(each);
        }
        values
    }

    /// Returns the probabilities of the formulas.
    pub fn outputs<'c>(&'c self, values: &'c Values) -> impl Iterator<Item = f64> + 'c {
        self.roots.iter().map(|root| values.of(*root))
    }

    /// Returns the derivatives by the probabilities of [`DiagramCircuit::variables`] of the sum of all formulas, each
    /// times its weight.
    pub fn gradient(&self, probabilities: &[f64], values: &Values, weights: &[f64]) -> Vec<f64> {
        let mut gradient = vec![0.0; self.variables.len()];
        let mut by_node = vec![0.0; self.nodes.len()];
        let signed = |formula: Formula, weight: f64| if formula.is_negated() { -weight } else { weight };
        for (root, weight) in self.roots.iter().zip(weights) {
            by_node[root.node()] += signed(*root, *weight);
        }
        for (at, node) in self.nodes.iter().enumerate().skip(1).rev() {
            let weight = by_node[at];
            if weight == 0.0 {
                continue;
            }
            let probability = probabilities[node.variable as usize];
            gradient[node.variable as usize] += weight * (values.of(node.holds) - values.of(node.fails));
            by_node[node.holds.node()] += signed(node.holds, weight * probability);
            by_node[node.fails.node()] += signed(node.fails, weight * (1.0 - probability));
        }
        gradient
    }
}
