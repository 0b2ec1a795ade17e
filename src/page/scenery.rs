//! What stays the same in a run: map, buildings, and the icons of the agents.

use crate::city::{AgentKind, Heading};
use crate::render::{Atlas, Class, Facing, GroundPlan, Icons, Site, ZonePlan};
use crate::sim::{Replay, TraceAgent};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::Serialize;
use std::collections::BTreeMap;

/// The maximum number of icon instances per class of agents, and per type of building.
const VARIANTS: u32 = 20;

/// The sizes of icons, in pixels: the short side of a car, and the sides of a pedestrian and of a building.
const SIZES: [u32; 3] = [40, 48, 80];

/// The map and all icons of a page.
#[derive(Serialize)]
pub struct Scenery {
    pub map: Map,
    /// The icons of cars, pedestrians and buildings; `None` without such icons.
    atlases: [Option<Sprites>; 3],
    /// For each agent, positions in its atlas: for a car one icon that faces up, for a pedestrian one per heading, in
    /// the order of [`Heading::ALL`].
    icons: Vec<Vec<usize>>,
}

/// The ground of the map, as [`GroundPlan`] describes it.
#[derive(Serialize)]
pub struct Map {
    pub name: String,
    rows: i32,
    cols: i32,
    /// Colors by name.
    colors: BTreeMap<&'static str, String>,
    surfaces: [&'static str; 8],
    bands: Vec<(u32, Vec<(u32, u32)>)>,
    /// For each building its icon, type, first row and column, and side.
    sites: Vec<(usize, String, i32, i32, i32)>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    zones: Vec<Zone>,
}

/// A zone, as [`ZonePlan`] describes it.
#[derive(Serialize, PartialEq, Eq)]
struct Zone {
    name: String,
    color: String,
    dash: [i32; 2],
    bands: Vec<(u32, Vec<(u32, u32)>)>,
}

/// An [`Atlas`] with its picture in base 64.
#[derive(Serialize)]
struct Sprites {
    png: String,
    size: u32,
    side: u32,
    columns: u32,
}

impl Scenery {
    pub fn new(icons: &Icons, agents: &[TraceAgent], replay: &Replay) -> Scenery {
        let (map, table) = (replay.world().map(), &replay.world().scenario.kinds);
        let [mut cars, mut pedestrians, mut buildings]: [Shown; 3] = Default::default();
        let icons_of_agents = (agents.iter().zip(replay.kinds()).enumerate())
            .map(|(position, (agent, &kind))| {
                let instance = agent.instance(position);
                let class = Class::agent(kind, &table.shown(kind, &agent.concepts));
                match kind {
                    AgentKind::Car => vec![cars.position(class, instance, Facing::Up)],
                    AgentKind::Pedestrian => (Heading::ALL.iter())
                        .map(|&heading| pedestrians.position(class.clone(), instance, heading.into()))
                        .collect(),
                }
            })
            .collect();
        let plan = GroundPlan::new(map, icons);
        let sites = (plan.sites.iter())
            .map(|site| {
                let Site { building, corner, .. } = *site;
                let class = Class::building(building);
                let name = class.to_string();
                let icon = buildings.position(class, site.instance, Facing::Up);
                (icon, name, corner.row, corner.col, site.side)
            })
            .collect();
        let zones = ZonePlan::all(map).into_iter().map(|zone| Zone {
            name: zone.name,
            color: hexadecimal(zone.color),
            dash: zone.dash,
            bands: zone.bands,
        });
        let [car, pedestrian, building] = SIZES;
        Scenery {
            map: Map {
                name: map.name.clone(),
                rows: map.rows(),
                cols: map.cols(),
                colors: (GroundPlan::COLORS.into_iter().zip(plan.colors))
                    .map(|(name, color)| (name, hexadecimal(color)))
                    .collect(),
                surfaces: GroundPlan::SURFACES,
                bands: plan.bands,
                sites,
                zones: zones.collect(),
            },
            atlases: [
                cars.atlas(icons, car),
                pedestrians.atlas(icons, pedestrian),
                buildings.atlas(icons, building),
            ],
            icons: icons_of_agents,
        }
    }
}

fn hexadecimal([r, g, b]: [u8; 3]) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

impl Map {
    /// Returns whether both maps have the same ground, buildings and zones in every cell.
    pub fn equals(&self, other: &Map) -> bool {
        fn site((_, name, row, col, side): &(usize, String, i32, i32, i32)) -> (&str, [i32; 3]) {
            (name, [*row, *col, *side])
        }
        (self.rows, self.cols, &self.bands) == (other.rows, other.cols, &other.bands)
            && self.sites.iter().map(site).eq(other.sites.iter().map(site))
            && self.zones == other.zones
    }
}

/// The icons of an atlas, each once.
#[derive(Default)]
struct Shown {
    icons: Vec<(Class, u32, Facing)>,
    known: BTreeMap<(Class, u32, Facing), usize>,
}

impl Shown {
    /// Returns the position of an icon, and adds it if it is new.
    fn position(&mut self, class: Class, instance: u32, facing: Facing) -> usize {
        let icon = (class, instance % VARIANTS, facing);
        let next = self.icons.len();
        let position = *self.known.entry(icon.clone()).or_insert(next);
        if position == next {
            self.icons.push(icon);
        }
        position
    }

    fn atlas(&self, icons: &Icons, size: u32) -> Option<Sprites> {
        let Atlas {
            png,
            size,
            side,
            columns,
        } = (!self.icons.is_empty()).then(|| icons.atlas(&self.icons, size))?;
        Some(Sprites {
            png: STANDARD.encode(png),
            size,
            side,
            columns,
        })
    }
}
