//! Draws the scenes of questions.

use crate::diag::Diagnostic;
use crate::render::{CloseUp, Icons, Picture, Sprite};
use crate::rng::Seed;
use crate::sim::{Settings, Simulation, World};
use crate::task::questions::wording::{picture_of_demonstration, picture_of_question};
use crate::task::questions::{Question, QuestionSet, words};
use std::collections::BTreeMap;
use std::sync::Arc;

impl QuestionSet {
    /// Draws the scene of each question and demonstration: the agents that it names, with their names, a frame around
    /// the car, and a legend. Calls `receive` with the file name of each picture in [`QuestionSet::write_json`].
    ///
    /// Drives each city again until the tick of the question, so `world` must be the one of [`QuestionSet::draw`].
    ///
    /// # Errors
    /// Those of [`Simulation::new`] and of `receive`.
    pub fn draw_pictures<E: From<Diagnostic>>(
        &self,
        world: &Arc<World>,
        icons: &Arc<Icons>,
        mut receive: impl FnMut(String, &Picture) -> Result<(), E>,
    ) -> Result<(), E> {
        let set = self.id(&world.scenario.name);
        let questions = self.questions.iter().enumerate();
        let questions = questions.map(|(number, question)| (picture_of_question(&set, number), question));
        let shown = self.demonstrations.iter().enumerate();
        let shown = shown.map(|(number, question)| (picture_of_demonstration(&set, number), question));
        // By city, so that each is driven once, then by tick.
        let mut cities: BTreeMap<_, BTreeMap<u64, Vec<(String, &Question)>>> = BTreeMap::new();
        for (name, question) in shown.chain(questions) {
            let ticks = cities
                .entry((question.source.split, question.source.world))
                .or_default();
            ticks.entry(question.source.tick).or_default().push((name, question));
        }
        let close_up = CloseUp::new(Arc::clone(icons), world.scenario.view);
        for ((split, seed), ticks) in cities {
            let mut city = Simulation::new(Arc::clone(world), split, Seed(seed), Settings::default())?;
            for (tick, questions) in ticks {
                while city.now() < tick {
                    city.tick(&[])?;
                }
                for (name, question) in questions {
                    let names = words::names(&self.predicates, question);
                    let agents = question.agents.iter().zip(&names);
                    let sprites = agents.map(|(&agent, name)| Sprite::of(&city.agents()[agent], name, None));
                    let picture = close_up.draw(world.map(), &sprites.collect::<Vec<_>>(), question.ego);
                    receive(name, &picture)?;
                }
            }
        }
        Ok(())
    }
}
