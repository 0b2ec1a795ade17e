//! Plans read back, and driven in the city.

use crate::city::Action;
use crate::diag::{Diagnostic, SourceId, Sources, Span};
use crate::task::spf::pddl::Costs;
use crate::task::spf::pddl::names::Names;
use crate::task::spf::{Env, codes};

/// A step of a plan: the action of the ego, and the places that the plan names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlanStep {
    /// The action.
    pub action: Action,
    /// The tick and the places before and after, on the route of the ego; `None` in the multi-agent encoding.
    pub moves: Option<(u32, [usize; 2])>,
    /// The place in the plan.
    pub span: Span,
}

/// A driven plan.
#[derive(Clone, Debug, PartialEq)]
pub struct Replay {
    /// The actions, each with the rules' own and the labels of the violated clauses.
    pub steps: Vec<(Action, Action, Vec<String>)>,
    /// The sum of the rewards of these steps.
    pub total: f64,
    /// The cost of the plan.
    pub cost: u64,
    /// Whether the ego is at its goal without a violation.
    pub success: bool,
}

fn invalid(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new(codes::INVALID_PLAN, message)
}

/// Reads a plan as planners print it: an action per line in parentheses, and comments after `;`.
///
/// # Errors
/// `invalid-plan` at the place of a line that is no action of a domain that `encode` makes for this task.
pub fn read_plan(env: &Env, source: SourceId, sources: &Sources) -> Result<Vec<PlanStep>, Diagnostic> {
    let table = env.task().world().vocabulary.actions();
    let mut names = Names::default();
    let deeds: Vec<(String, Action)> = table
        .all()
        .map(|action| (names.unique(table.name(action)), action))
        .collect();
    let text = sources.text(source);
    let (mut steps, mut begin) = (Vec::new(), 0);
    for line in text.split_inclusive('\n') {
        let start = begin;
        begin += line.len();
        let content = line.split(';').next().unwrap_or_default();
        let trimmed = content.trim();
        if trimmed.is_empty() {
            continue;
        }
        let offset = start + (content.len() - content.trim_start().len());
        let span = Span::new(source, offset..offset + trimmed.len());
        let fault = |message: String| invalid(message).at(span, "in this line");
        let inner = trimmed
            .strip_prefix('(')
            .and_then(|rest| rest.strip_suffix(')'))
            .unwrap_or(trimmed);
        let words: Vec<String> = inner
            .split([' ', ',', '(', ')'])
            .filter(|word| !word.is_empty())
            .map(str::to_lowercase)
            .collect();
        let Some((name, arguments)) = words.split_first() else {
            return Err(fault("a line has no action".to_owned()).help("write an action, such as `(choose-slow)`"));
        };
        if name == "tick" || name == "arrive" {
            continue;
        }
        let of = |start: &str| {
            let deed = name.strip_prefix(start)?;
            deeds.iter().find(|(known, _)| known == deed).map(|(_, action)| *action)
        };
        let number = |word: &String, letter: char| word.strip_prefix(letter)?.parse::<u32>().ok();
        let step = match (of("choose-"), of("go-"), arguments) {
            (Some(action), _, []) => (action, None),
            (_, Some(action), [tick, _, from, to]) => {
                let read = (|| {
                    Some((
                        number(tick, 't')?,
                        [number(from, 'p')? as usize, number(to, 'p')? as usize],
                    ))
                })();
                match read {
                    Some(moves) => (action, Some(moves)),
                    None => {
                        return Err(
                            fault(format!("`{trimmed}` names no ticks and places")).help("they are such as t4 and p12")
                        );
                    }
                }
            }
            _ => {
                let known: Vec<String> = deeds.iter().map(|(deed, _)| format!("go-{deed}")).collect();
                let help = format!(
                    "the actions are {}, `choose-` instead of `go-`, tick and arrive",
                    known.join(", ")
                );
                return Err(fault(format!("`{trimmed}` is no action of the domain")).help(help));
            }
        };
        steps.push(PlanStep {
            action: step.0,
            moves: step.1,
            span,
        });
    }
    match steps.is_empty() {
        true => Err(invalid("the plan has no action of the ego").help("a planner that found no plan writes none")),
        false => Ok(steps),
    }
}

/// Drives a plan in an episode that has just begun, after `start` steps that the rules drive. The environment judges
/// every action. A violation ends the replay.
///
/// # Errors
/// `invalid-plan` if the episode ends before the plan, or the plan names a tick or a place that is not the ego's;
/// `limit-exceeded` if the rules derive too many rows.
pub fn replay(env: &mut Env, start: u32, plan: &[PlanStep]) -> Result<Replay, Diagnostic> {
    let costs = Costs::new(env.task(), env.controlled_cars()[0].cells())?;
    for _ in 0..start {
        if !env.controlled_cars()[0].is_running() {
            let message = format!(
                "the rules end the episode in {} steps, before the start of the plan",
                env.steps()
            );
            return Err(invalid(message).help("choose an earlier start"));
        }
        let wanted = env.oracle_action(0);
        env.step(&[wanted])?;
    }
    let mut done = Replay {
        steps: Vec::new(),
        total: 0.0,
        cost: 0,
        success: false,
    };
    for step in plan {
        let fault = |message: String, place: &str| Err(invalid(message).at(step.span, place));
        if !env.controlled_cars()[0].is_running() {
            return fault(
                format!("the episode ends after {} steps, before the plan", env.steps()),
                "this action is left",
            );
        }
        let ego = env.controlled_cars()[0].agent();
        let before = (env.steps(), env.city().agents()[ego].position());
        let wanted = env.oracle_action(0);
        env.step(&[step.action])?;
        let last = env.controlled_cars()[0].last();
        let broken = last.broken.iter().map(|&clause| env.task().label(clause).to_owned());
        done.steps.push((step.action, wanted, broken.collect()));
        done.total += last.reward;
        done.success = last.success;
        done.cost += costs.of(step.action).unwrap_or(0);
        let after = env.city().agents()[ego].position();
        if let Some((tick, places)) = step.moves
            && (tick, places) != (before.0, [before.1, after])
        {
            let message = format!(
                "the plan moves the ego from p{} to p{} at t{tick}, but the city moves it from p{} to p{after} at t{}",
                places[0], places[1], before.1, before.0
            );
            return fault(message, "this action does not fit");
        }
        // A violation ends the episode, so what follows in the plan does not matter.
        if !env.controlled_cars()[0].last().broken.is_empty() {
            break;
        }
    }
    Ok(done)
}
