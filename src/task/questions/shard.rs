//! Shards of questions: the questions of a part of the worlds, before a set chooses some of them.

use crate::city::{Action, AgentSet, Split};
use crate::diag::{Diagnostic, SourceId, Span};
use crate::sim::{Facts, World};
use crate::task::questions::mix::Category;
use crate::task::questions::{
    CATEGORY_WORLDS, Extent, Known, Mix, Prompt, QUESTIONS_MAX, Question, QuestionSearch, Request, SHOTS_MAX, Source,
    Style, TICKS, WORLDS, check, demonstrations,
};
use crate::task::shard::{self, Origin, Shard, ShardText};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::sync::Arc;

/// What the files of shards of questions are of.
pub const QUESTION_SHARDS: &str = "logicity questions";

/// The questions of a part of the worlds.
#[derive(Clone, Debug, PartialEq)]
pub struct QuestionShard {
    /// Which part.
    pub shard: Shard,
    /// The number of searched worlds of this part.
    pub searched: u64,
    /// The questions by the number of their world.
    worlds: BTreeMap<u64, Vec<(Category, Question)>>,
}

/// A [`Request`] in the file of a shard.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RequestRecord {
    count: usize,
    shots: usize,
    split: String,
    demonstrations: String,
    entities: String,
    style: String,
    prompt: String,
    mix: String,
    about: Vec<String>,
    seed: u64,
}

impl RequestRecord {
    /// Returns the record of a request.
    pub fn of(request: &Request) -> RequestRecord {
        RequestRecord {
            count: request.count,
            shots: request.shots,
            split: request.split.name().to_owned(),
            demonstrations: request.demonstrations.name().to_owned(),
            entities: request.entities.name().to_owned(),
            style: request.style.name().to_owned(),
            prompt: request.prompt.name().to_owned(),
            mix: request.mix.name().to_owned(),
            about: request.about.clone(),
            seed: request.seed,
        }
    }

    /// Returns the request.
    ///
    /// # Errors
    /// `invalid-shard` if a name is unknown, or a number out of range.
    pub fn request(&self) -> Result<Request, Diagnostic> {
        fn named<T: Copy>(all: &[T], name: fn(T) -> &'static str, text: &str) -> Result<T, Diagnostic> {
            let found = all.iter().copied().find(|&one| name(one) == text);
            found.ok_or_else(|| shard::invalid(format!("the request of a shard has the unknown value `{text}`")))
        }
        if !(1..=QUESTIONS_MAX as usize).contains(&self.count) || self.shots > SHOTS_MAX as usize {
            let message = format!(
                "the request of a shard has {} questions, {} shots",
                self.count, self.shots
            );
            return Err(shard::invalid(message).help(format!("at most {QUESTIONS_MAX} and {SHOTS_MAX} are possible")));
        }
        Ok(Request {
            count: self.count,
            shots: self.shots,
            split: named(&Split::ALL, Split::name, &self.split)?,
            demonstrations: named(&Split::ALL, Split::name, &self.demonstrations)?,
            entities: named(&Extent::ALL, Extent::name, &self.entities)?,
            style: named(&Style::ALL, Style::name, &self.style)?,
            prompt: named(&Prompt::ALL, Prompt::name, &self.prompt)?,
            mix: named(&Mix::ALL, Mix::name, &self.mix)?,
            about: self.about.clone(),
            seed: self.seed,
        })
    }
}

/// A question in the file of a shard.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    world: u64,
    concepts: Vec<String>,
    answer: String,
    ego: usize,
    agents: Vec<usize>,
    facts: Vec<Vec<[u32; 2]>>,
    seed: u64,
    tick: u64,
    car: String,
}

impl Line {
    fn of(world: u64, (concepts, _): &Category, question: &Question) -> Line {
        Line {
            world,
            concepts: concepts.clone(),
            answer: question.answer.name().to_owned(),
            ego: question.ego,
            agents: question.agents.clone(),
            facts: question.facts.rows.clone(),
            seed: question.source.world,
            tick: question.source.tick,
            car: question.source.agent.to_string(),
        }
    }

    fn read(self, world: &World, split: Split) -> Result<(u64, (Category, Question)), Diagnostic> {
        let answer = Action::STANDARD.into_iter().find(|action| action.name() == self.answer);
        let set = world.scenario.agent_set(split);
        let car = set.and_then(|set| {
            set.members()
                .map(|(name, _)| name)
                .find(|name| name.to_string() == self.car)
        });
        let predicates = &world.vocabulary.predicates;
        let entities = self.agents.len();
        let fits = |row: &[u32; 2], arity: usize| {
            (row[0] as usize) < entities
                && if arity == 1 {
                    row[1] == 0
                } else {
                    (row[1] as usize) < entities
                }
        };
        let faultless = self.ego < entities
            && self.tick < TICKS
            && self.agents.iter().all(|&agent| agent < set.map_or(0, AgentSet::len))
            && self.facts.len() == predicates.len()
            && (self.facts.iter().zip(predicates)).all(|(rows, predicate)| {
                rows.is_sorted_by(|one, next| one < next) && rows.iter().all(|row| fits(row, predicate.arity))
            });
        let (Some(answer), Some(agent), true) = (answer, car, faultless) else {
            return Err(shard::invalid("the question does not fit the city"));
        };
        let question = Question {
            entities,
            ego: self.ego,
            agents: self.agents,
            facts: Facts::of(self.facts),
            answer,
            clauses: Vec::new(),
            source: Source {
                split,
                world: self.seed,
                tick: self.tick,
                agent,
            },
        };
        Ok((self.world, ((self.concepts, answer), question)))
    }
}

impl QuestionShard {
    /// Searches a part of the worlds of [`QuestionSet::draw`](super::QuestionSet::draw) until it has its share of the
    /// questions. `watch` as there.
    ///
    /// # Errors
    /// As there, but the shard may have too few questions.
    pub fn draw(
        world: &Arc<World>,
        request: &Request,
        shard: Shard,
        mut watch: impl FnMut(usize),
    ) -> Result<QuestionShard, Vec<Diagnostic>> {
        check(world, request)?;
        let mut known = Known::default();
        demonstrations(world, request, &mut known).map_err(|fault| vec![fault])?;
        let count = shard.share(request.count);
        let mut search = QuestionSearch::new(world, request, request.split, (count, request.mix));
        search.category_worlds = shard.share(CATEGORY_WORLDS);
        let mut city = search.city().map_err(|fault| vec![fault])?;
        let (mut searched, mut worlds) = (0, BTreeMap::new());
        while searched < shard.share(WORLDS + request.count) as u64 {
            let wanted = search.wanted().into_iter();
            let found = wanted
                .map(|(category, share)| search.available(&category).min(share))
                .sum();
            watch(found);
            if found >= count {
                break;
            }
            let number = shard.item(searched);
            searched += 1;
            let found = search
                .look(&mut city, &request.about, number)
                .map_err(|fault| vec![fault])?;
            let fresh = known.fresh(world, found);
            worlds.insert(number, fresh.clone());
            search.add(fresh);
        }
        Ok(QuestionShard {
            shard,
            searched,
            worlds,
        })
    }

    /// Returns the questions of a world, if one of all shards has searched it.
    pub(super) fn found(shards: &[QuestionShard], world: u64) -> Option<Vec<(Category, Question)>> {
        let of = shards.len().max(1) as u64;
        let shard = shards.get((world % of) as usize)?;
        (world / of < shard.searched).then(|| shard.worlds.get(&world).cloned().unwrap_or_default())
    }

    /// Writes the file of the shard.
    ///
    /// # Errors
    /// Errors of `out`.
    pub fn write(&self, origin: &Origin<RequestRecord>, out: &mut impl Write) -> io::Result<()> {
        let lines = (self.worlds.iter()).flat_map(|(&world, found)| {
            found
                .iter()
                .map(move |(category, question)| (world, category, question))
        });
        let lines = lines.map(|(world, category, question)| Line::of(world, category, question));
        shard::write(out, (QUESTION_SHARDS, self.shard), origin, self.searched, lines)
    }

    /// Reads the lines of a shard, which follow its header.
    ///
    /// # Errors
    /// `invalid-shard` with the place of the line.
    pub fn read(
        ShardText { header, lines }: &ShardText<'_, RequestRecord>,
        source: SourceId,
        world: &World,
    ) -> Result<QuestionShard, Diagnostic> {
        let split = header.origin.request.request()?.split;
        let mut worlds: BTreeMap<u64, Vec<(Category, Question)>> = BTreeMap::new();
        for (start, text) in lines {
            let line: Line = shard::parse(text, source, *start, "a question of a shard")?;
            let here = |fault: Diagnostic| fault.at(Span::new(source, *start..start + text.len()), "in this line");
            let (number, found) = line.read(world, split).map_err(here)?;
            worlds.entry(number).or_default().push(found);
        }
        Ok(QuestionShard {
            shard: header.shard,
            searched: header.searched,
            worlds,
        })
    }
}
