//! Pictures of one view of a map: draws the ground once and the agents every time.
// Decision: docs/decisions/pictures.md#d061

use crate::city::AgentKind;
use crate::city::CityMap;
use crate::render::ground;
use crate::render::ground::Look;
use crate::render::icon::Icons;
use crate::render::picture::Picture;
use crate::render::picture::{PixelBox, Silhouette, Stamp};
use crate::render::sprite::Sprite;
use crate::render::view::Viewport;
use crate::render::weather::Weather;
use crate::render::zone;
use crate::rng::Seed;
use std::sync::Arc;

/// Computes where agents are in pictures of one view of one map, without drawing.
#[derive(Clone, Debug)]
pub struct Placement {
    icons: Arc<Icons>,
    view: Viewport,
    /// Rows and columns of the map.
    cells: (i32, i32),
}

impl Placement {
    /// Returns the placement for pictures with these icons.
    pub fn new(map: &CityMap, icons: Arc<Icons>, view: Viewport) -> Placement {
        Placement {
            icons,
            view,
            cells: (map.rows(), map.cols()),
        }
    }

    /// Returns the icons.
    pub fn icons(&self) -> &Arc<Icons> {
        &self.icons
    }

    /// Returns the boxes of [`Renderer::boxes`].
    pub fn boxes(&self, agents: &[Sprite<'_>]) -> Vec<Option<PixelBox>> {
        agents.iter().map(|agent| self.pixel_box(agent)).collect()
    }

    fn pixel_box(&self, agent: &Sprite<'_>) -> Option<PixelBox> {
        let body = self.body(agent)?;
        match &agent.framing {
            None => self.clipped(&body),
            Some(framing) => framing.loosened(body.area(), self.view.car, self.view.size()),
        }
    }

    /// Returns the fraction of each agent that the picture shows: of the pixels of its icon inside the picture, those
    /// that nothing drawn later covers. Pixels count where an icon or a cover is at least half opaque, without shadows.
    /// `None` if the agent has no box.
    pub fn visible(&self, agents: &[Sprite<'_>]) -> Vec<Option<f32>> {
        let mut fractions = vec![None; agents.len()];
        // From the top down: each body, with its box.
        let mut above: Vec<(PlacedBody, PixelBox)> = Vec::new();
        let covers = (self.covers(agents)).filter_map(|cover| {
            let body = cover.body();
            let area = self.clipped(&body)?;
            Some((body, area))
        });
        above.extend(covers);
        for at in drawing_order(agents).rev() {
            let Some(body) = self.body(&agents[at]) else { continue };
            let Some(area) = self.clipped(&body) else { continue };
            let covers: Vec<&PlacedBody> = (above.iter())
                .filter(|(_, other)| other.overlaps(area))
                .map(|(body, _)| body)
                .collect();
            let (right, bottom) = (area.x + area.width.cast_signed(), area.y + area.height.cast_signed());
            let pixels = (area.y..bottom).flat_map(|y| (area.x..right).map(move |x| (x, y)));
            let mut own = pixels.filter(|&(x, y)| body.contains(x, y));
            fractions[at] = Some(match covers.is_empty() {
                true => f32::from(u8::from(own.next().is_some())),
                false => {
                    let (mut all, mut shown) = (0_u32, 0_u32);
                    for (x, y) in own {
                        all += 1;
                        shown += u32::from(!covers.iter().any(|cover| cover.contains(x, y)));
                    }
                    #[allow(clippy::cast_precision_loss)]
                    let fraction = shown as f32 / all.max(1) as f32;
                    fraction
                }
            });
            above.push((body, area));
        }
        fractions
    }

    /// Returns what each pixel of the picture shows, row by row: one more than the position of an agent, and 0 where no
    /// agent is or a cover hides it. The pixels of an agent are those that [`Placement::visible`] counts.
    ///
    /// # Panics
    /// If there are more than 255 agents.
    pub fn mask(&self, agents: &[Sprite<'_>]) -> Vec<u8> {
        let (width, height) = self.view.size();
        let mut mask = vec![0; width as usize * height as usize];
        let mut paint = |body: &PlacedBody, value: u8| {
            let Some(area) = self.clipped(body) else { return };
            let (right, bottom) = (area.x + area.width.cast_signed(), area.y + area.height.cast_signed());
            for (x, y) in (area.y..bottom).flat_map(|y| (area.x..right).map(move |x| (x, y))) {
                if body.contains(x, y) {
                    mask[y.cast_unsigned() as usize * width as usize + x.cast_unsigned() as usize] = value;
                }
            }
        };
        for at in drawing_order(agents) {
            if let Some(body) = self.body(&agents[at]) {
                paint(&body, u8::try_from(at + 1).expect("there are at most 255 agents"));
            }
        }
        self.covers(agents).for_each(|cover| paint(&cover.body(), 0));
        mask
    }

    fn body(&self, agent: &Sprite<'_>) -> Option<PlacedBody> {
        let (x, y) = self.middle(agent)?;
        let body = (self.icons).body(&agent.class(), agent.instance, agent.facing, self.size(agent));
        Some(PlacedBody { body, x, y })
    }

    /// Returns what hides parts of agents, in the order in which it is drawn.
    fn covers<'a>(&'a self, agents: &'a [Sprite<'_>]) -> impl Iterator<Item = Placed> + 'a {
        drawing_order(agents).filter_map(|at| {
            let agent = &agents[at];
            let framing = agent.framing.as_ref()?;
            let PlacedBody { body, x, y } = self.body(agent)?;
            let stamp = Arc::new(framing.cover(body.area)?);
            Some(Placed { stamp, x, y })
        })
    }

    /// Returns the part of a body's box that is in the picture.
    fn clipped(&self, body: &PlacedBody) -> Option<PixelBox> {
        let (width, height) = self.view.size();
        body.area().clipped(width, height)
    }

    fn stamp(&self, agent: &Sprite<'_>) -> Option<Placed> {
        let (x, y) = self.middle(agent)?;
        let stamp = (self.icons).stamp(&agent.class(), agent.instance, agent.facing, self.size(agent));
        Some(Placed { stamp, x, y })
    }

    /// Returns the center of the agent's icon; `None` if it is off the map or far off the picture.
    fn middle(&self, agent: &Sprite<'_>) -> Option<(i32, i32)> {
        let (rows, cols) = self.cells;
        let on_map = (0..rows).contains(&agent.at.row) && (0..cols).contains(&agent.at.col);
        on_map.then(|| self.view.middle(agent.at))?
    }

    /// Returns the size of an agent's icon.
    fn size(&self, agent: &Sprite<'_>) -> u32 {
        let usual = match agent.kind {
            AgentKind::Car => self.view.car,
            AgentKind::Pedestrian => self.view.pedestrian,
        };
        let Some(framing) = &agent.framing else { return usual };
        let class = agent.class();
        framing.size(usual, self.view.car, |size| {
            (self.icons).body(&class, agent.instance, agent.facing, size).area
        })
    }
}

/// Draws pictures of one view of one map.
///
/// Draws the ground once and every icon once; a picture is a copy of the ground with icons on top, in the weather of
/// the ground. It depends only on map, icons, view, ground and agents, not on earlier pictures or the number of
/// threads.
#[derive(Clone, Debug)]
pub struct Renderer {
    placement: Placement,
    /// The picture without agents.
    ground: Picture,
    /// The weather, and the ground without it.
    weather: Option<(Weather, Picture)>,
}

/// Returns the agents in the order in which they are drawn: cars, then pedestrians.
fn drawing_order(agents: &[Sprite<'_>]) -> impl DoubleEndedIterator<Item = usize> {
    let of = |kind: AgentKind| (0..agents.len()).filter(move |&at| agents[at].kind == kind);
    of(AgentKind::Car).chain(of(AgentKind::Pedestrian))
}

/// A body at its place.
struct PlacedBody {
    body: Arc<Silhouette>,
    /// Its center.
    x: i32,
    y: i32,
}

impl PlacedBody {
    /// Returns its box in the picture, which may extend beyond the picture.
    fn area(&self) -> PixelBox {
        PixelBox {
            x: self.x + self.body.area.x,
            y: self.y + self.body.area.y,
            ..self.body.area
        }
    }

    /// Whether a pixel of the picture belongs to the body.
    fn contains(&self, x: i32, y: i32) -> bool {
        self.body.contains(x - self.x, y - self.y)
    }
}

/// An icon at its place.
struct Placed {
    stamp: Arc<Stamp>,
    /// Its center.
    x: i32,
    y: i32,
}

impl Placed {
    /// Returns its pixels that are at least half opaque.
    fn body(&self) -> PlacedBody {
        PlacedBody {
            body: Arc::clone(&self.stamp.body),
            x: self.x,
            y: self.y,
        }
    }

    /// Returns its pixels in the picture, which may extend beyond the picture.
    fn area(&self) -> PixelBox {
        PixelBox {
            x: self.x.saturating_add(self.stamp.area.x),
            y: self.y.saturating_add(self.stamp.area.y),
            ..self.stamp.area
        }
    }
}

/// Returns rectangles with the pixels of the given ones, each pixel once.
fn disjoint(areas: &[PixelBox]) -> Vec<PixelBox> {
    let ends = |area: &PixelBox| (area.y, area.y + area.height.cast_signed());
    let mut cuts: Vec<i32> = areas.iter().flat_map(|area| <[i32; 2]>::from(ends(area))).collect();
    cuts.sort_unstable();
    cuts.dedup();
    let mut found: Vec<PixelBox> = Vec::new();
    // Between two cuts, the same rectangles cover every row.
    for (&top, &bottom) in cuts.iter().zip(cuts.iter().skip(1)) {
        let of_band = areas
            .iter()
            .filter(|area| ends(area).0 <= top && bottom <= ends(area).1);
        let mut spans: Vec<(i32, i32)> = of_band
            .map(|area| (area.x, area.x + area.width.cast_signed()))
            .collect();
        spans.sort_unstable();
        let mut reached = i32::MIN;
        for (left, right) in spans {
            let left = left.max(reached);
            if left < right {
                found.push(PixelBox {
                    x: left,
                    y: top,
                    width: (right - left).cast_unsigned(),
                    height: (bottom - top).cast_unsigned(),
                });
                reached = right;
            }
        }
    }
    found
}

impl Renderer {
    /// Draws the ground with textures from the icons' seed.
    pub fn new(map: &CityMap, icons: Arc<Icons>, view: Viewport) -> Renderer {
        let look = Look::of(&icons);
        Renderer::with_look(map, Placement::new(map, icons, view), look, false)
    }

    /// Draws the ground like [`Renderer::new`], and the zones of the map on it.
    pub fn with_zones(map: &CityMap, icons: Arc<Icons>, view: Viewport) -> Renderer {
        let look = Look::of(&icons);
        Renderer::with_look(map, Placement::new(map, icons, view), look, true)
    }

    /// Draws a separate ground: `seed` determines the textures and the instance of each building.
    pub fn with_ground(map: &CityMap, placement: Placement, seed: Seed) -> Renderer {
        Renderer::with_look(map, placement, Look::drawn(seed), false)
    }

    fn with_look(map: &CityMap, placement: Placement, look: Look, has_zones: bool) -> Renderer {
        let mut ground = ground::draw(map, &placement.icons, &placement.view, look);
        if has_zones {
            zone::draw(map, &placement.view, &mut ground);
        }
        let noise = placement.icons.disguise().share();
        let weather = (noise > 0.0).then(|| {
            let weather = Weather::drawn(look.seed, noise, placement.view.start(), placement.view.size());
            let dry = ground.clone();
            weather.apply(&mut ground, placement.view.area());
            (weather, dry)
        });
        Renderer {
            placement,
            ground,
            weather,
        }
    }

    /// Returns the view.
    pub fn view(&self) -> &Viewport {
        &self.placement.view
    }

    /// Returns the icons.
    pub fn icons(&self) -> &Arc<Icons> {
        &self.placement.icons
    }

    /// Returns the picture without agents.
    pub fn ground(&self) -> &Picture {
        &self.ground
    }

    /// Draws agents. Pedestrians cover cars, and later agents cover earlier ones of the same type. What hides parts of
    /// agents covers all of them.
    pub fn draw(&self, agents: &[Sprite<'_>]) -> Picture {
        let mut picture = self.ground.clone();
        self.add_agents(agents, &mut picture);
        picture
    }

    /// Draws agents like [`Renderer::draw`] and reuses the memory of `picture`.
    pub fn draw_into(&self, agents: &[Sprite<'_>], picture: &mut Picture) {
        picture.copy_from(&self.ground);
        self.add_agents(agents, picture);
    }

    fn add_agents(&self, agents: &[Sprite<'_>], picture: &mut Picture) {
        let icons = drawing_order(agents).filter_map(|at| self.placement.stamp(&agents[at]));
        let stamps: Vec<Placed> = icons.chain(self.placement.covers(agents)).collect();
        let areas: Vec<PixelBox> = match &self.weather {
            None => Vec::new(),
            Some(_) => {
                let (width, height) = self.placement.view.size();
                let areas = stamps.iter().filter_map(|placed| placed.area().clipped(width, height));
                areas.collect()
            }
        };
        // Where there are agents, the weather applies to them and the ground together.
        if let Some((_, dry)) = &self.weather {
            areas.iter().for_each(|&area| picture.copy_area(dry, area));
        }
        for Placed { stamp, x, y } in stamps {
            picture.stamp(&stamp, x, y);
        }
        if let Some((weather, _)) = &self.weather {
            for area in disjoint(&areas) {
                weather.apply(picture, area);
            }
        }
    }

    /// Returns the box of each agent, in the picture; `None` if the agent is off the map or the picture.
    ///
    /// A box contains the part of the icon in the picture, without shadow and skid marks. Without a framing it touches
    /// that part on all sides; a framing makes it larger.
    pub fn boxes(&self, agents: &[Sprite<'_>]) -> Vec<Option<PixelBox>> {
        self.placement.boxes(agents)
    }

    /// Returns the visible fraction of each agent, as [`Placement::visible`].
    pub fn visible(&self, agents: &[Sprite<'_>]) -> Vec<Option<f32>> {
        self.placement.visible(agents)
    }

    pub(super) fn pixel_box(&self, agent: &Sprite<'_>) -> Option<PixelBox> {
        self.placement.pixel_box(agent)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::city::Cell;
    use crate::city::{Blocks, Building, Buildings, MapConfig, Split, Terrain, Widths};
    use crate::diag::{Sources, Span};
    use crate::located::Located;
    use crate::render::{Difficulty, DrawingVersion, Facing, Scale};
    use crate::rng::{Purpose, RngExt, Seed};

    fn map() -> CityMap {
        let mut sources = Sources::new();
        let span = Span::new(sources.add("map", ""), 0..0);
        let widths = Widths {
            street: 7,
            sidewalk: 3,
            building: 5,
            inner_sidewalk: 2,
        };
        let config = MapConfig {
            name: "test".into(),
            terrain: Terrain::Blocks(Blocks {
                blocks: Located { value: [2, 2], span },
                widths: Located { value: widths, span },
                buildings: Located {
                    value: Buildings::Random {
                        seed: 4,
                        weights: Building::ALL.map(|building| (building, 1.0)).to_vec(),
                    },
                    span,
                },
            }),
            zones: Vec::new(),
        };
        CityMap::generate(&config).unwrap_or_else(|fault| panic!("{fault:?}"))
    }

    /// Draws the icon of an agent again, and returns it with its box in a picture.
    fn drawn(icons: &Icons, view: &Viewport, agent: &Sprite<'_>) -> (Stamp, Option<PixelBox>) {
        let draw = |size| icons.draw(&agent.class(), agent.instance, agent.facing, size);
        let usual = match agent.kind {
            AgentKind::Car => view.car,
            AgentKind::Pedestrian => view.pedestrian,
        };
        let body = |stamp: &Stamp| {
            let (x, y) = center(view, agent);
            let area = stamp.body.area;
            PixelBox {
                x: x + area.x,
                y: y + area.y,
                ..area
            }
        };
        let (width, height) = view.size();
        match &agent.framing {
            None => {
                let stamp = draw(usual);
                let area = body(&stamp).clipped(width, height);
                (stamp, area)
            }
            Some(framing) => {
                let stamp = draw(framing.size(usual, view.car, |size| draw(size).body.area));
                let area = framing.loosened(body(&stamp), view.car, (width, height));
                (stamp, area)
            }
        }
    }

    fn center(view: &Viewport, agent: &Sprite<'_>) -> (i32, i32) {
        let middle = |cell: i32, corner: i32| (cell - corner) * view.scale.pixels + view.scale.pixels / 2;
        (
            middle(agent.at.col, view.corner.col),
            middle(agent.at.row, view.corner.row),
        )
    }

    /// Reference implementation: draws pixel by pixel without caches.
    fn slowly(map: &CityMap, icons: &dyn Fn() -> Icons, view: &Viewport, look: Look, agents: &[Sprite<'_>]) -> Vec<u8> {
        let (width, height) = view.size();
        let mut pixels = vec![0; 3 * (width * height) as usize];
        let side = view.scale.pixels as usize;
        for row in 0..view.rows {
            for col in 0..view.cols {
                let corner = Cell::new(view.corner.row + row, view.corner.col + col);
                let view = Viewport::new(corner, 1, 1, view.scale).expect("a cell");
                let cell = ground::draw(map, &icons(), &view, look);
                for (line, from) in cell.pixels().chunks_exact(3 * side).enumerate() {
                    let at = 3 * ((row as usize * side + line) * width as usize + col as usize * side);
                    pixels[at..at + 3 * side].copy_from_slice(from);
                }
            }
        }
        let mut order: Vec<&Sprite<'_>> = agents.iter().filter(|agent| map.contains(agent.at)).collect();
        order.sort_by_key(|agent| agent.kind == AgentKind::Pedestrian);
        let stamps = order
            .iter()
            .map(|agent| (center(view, agent), drawn(&icons(), view, agent).0));
        let mut stamps: Vec<((i32, i32), Stamp)> = stamps.collect();
        for (at, agent) in order.iter().enumerate() {
            let (center, body) = (stamps[at].0, stamps[at].1.body.area);
            let cover = agent.framing.and_then(|framing| framing.cover(body));
            stamps.extend(cover.map(|cover| (center, cover)));
        }
        for ((x, y), Stamp { area, pixels: icon, .. }) in stamps {
            let (left, top) = (x + area.x, y + area.y);
            for (at, pixel) in pixels.chunks_exact_mut(3).enumerate() {
                let (x, y) = (at as i32 % width as i32 - left, at as i32 / width as i32 - top);
                if (0..area.width as i32).contains(&x) && (0..area.height as i32).contains(&y) {
                    let over = &icon[4 * (y * area.width as i32 + x) as usize..][..4];
                    for (below, over_channel) in pixel.iter_mut().zip(over) {
                        let through = f64::from(*below) * f64::from(255 - over[3]) / 255.0;
                        *below = over_channel + (through + 0.5 - 1e-9) as u8;
                    }
                }
            }
        }
        let noise = icons().disguise().share();
        let mut picture = Picture::from_pixels(width, height, pixels);
        if noise > 0.0 {
            Weather::drawn(look.seed, noise, view.start(), view.size()).apply(&mut picture, view.area());
        }
        picture.into_pixels()
    }

    /// Reference implementation of [`Placement::visible`] and [`Placement::mask`]: paints the number of each agent over
    /// its body, pixel by pixel, as complete drawings have it. Returns how many pixels of each agent the picture shows,
    /// how many it has in the picture, and the agent of each pixel.
    fn slowly_visible(
        icons: &Icons,
        view: &Viewport,
        map: &CityMap,
        agents: &[Sprite<'_>],
    ) -> (Vec<(u32, u32)>, Vec<Option<usize>>) {
        let (width, height) = view.size();
        let mut owner = vec![None; (width * height) as usize];
        let mut counts = vec![(0, 0); agents.len()];
        let mut covers = Vec::new();
        let mut order: Vec<usize> = (0..agents.len()).collect();
        order.sort_by_key(|&at| agents[at].kind == AgentKind::Pedestrian);
        for at in order.into_iter().filter(|&at| map.contains(agents[at].at)) {
            let agent = &agents[at];
            let (stamp, _) = drawn(icons, view, agent);
            let (x, y) = center(view, agent);
            covers.extend(
                agent
                    .framing
                    .and_then(|framing| framing.cover(stamp.body.area))
                    .map(|cover| (cover, x, y)),
            );
            for (place, owner) in owner.iter_mut().enumerate() {
                let place = ((place as u32 % width) as i32 - x, (place as u32 / width) as i32 - y);
                if stamp.body.contains(place.0, place.1) {
                    counts[at].1 += 1;
                    *owner = Some(at);
                }
            }
        }
        for (cover, x, y) in covers {
            for (place, owner) in owner.iter_mut().enumerate() {
                if cover
                    .body
                    .contains((place as u32 % width) as i32 - x, (place as u32 / width) as i32 - y)
                {
                    *owner = None;
                }
            }
        }
        owner.iter().flatten().for_each(|&at| counts[at].0 += 1);
        (counts, owner)
    }

    /// Draws the agents without each of them: only its own pixels of the mask change, to what is below it, and every
    /// pixel of the picture that changes is near the agent.
    fn without_each(renderer: &Renderer, agents: &[Sprite<'_>], mask: &[u8]) {
        let whole = renderer.draw(agents);
        for at in 0..agents.len() {
            let mut others = agents.to_vec();
            others.remove(at);
            let (rest, picture) = (renderer.placement.mask(&others), renderer.draw(&others));
            let number = at as u8 + 1;
            let mut own = 0;
            for (place, (&now, &then)) in mask.iter().zip(&rest).enumerate() {
                let renumbered = then + u8::from(then >= number);
                if now == number {
                    let pixel = 3 * place..3 * place + 3;
                    own += u32::from(whole.pixels()[pixel.clone()] != picture.pixels()[pixel]);
                } else if agents[at].framing.is_none() {
                    // Without a cover of its own, the agent hides only what it shows.
                    assert_eq!(now, renumbered, "agent {at}");
                }
            }
            let shown = mask.iter().filter(|&&value| value == number).count();
            // A pixel may have the color of what is below it.
            assert!(f64::from(own) >= 0.9 * shown as f64, "agent {at}: {own} of {shown}");
        }
    }

    #[test]
    fn slow_what_is_kept_makes_no_difference() {
        let map = map();
        let concepts = ["bus", "tiro", "ambulance", "taxi", "old", "young"].map(str::to_owned);
        let mut covered = 0;
        for case in 0..8 {
            let mut stream = Seed(9).stream(Purpose::TEST, case, 0);
            let percent = stream.random_range(0..=100);
            let version = DrawingVersion::ALL[case as usize % 4 / 2];
            let icons = || {
                let difficulty = Difficulty::percent(percent).expect("a percentage");
                Icons::new(Seed(case), difficulty)
                    .with_version(version)
                    .with_split(Split::Test)
            };
            let corner = Cell::new(stream.random_range(-3..20), stream.random_range(-3..20));
            let scale = Scale::pixels(stream.random_range(1..9)).expect("a scale");
            let view = Viewport::new(corner, 14, 11, scale).expect("a view");
            let placement = Placement::new(&map, Arc::new(icons()), view);
            let (renderer, look) = match case % 2 {
                0 => (Renderer::new(&map, Arc::new(icons()), view), Look::of(&icons())),
                _ => {
                    let seed = Seed(case + 100);
                    (Renderer::with_ground(&map, placement.clone(), seed), Look::drawn(seed))
                }
            };
            for _ in 0..2 {
                let agents: Vec<Sprite<'_>> = (0..5)
                    .map(|_| {
                        let first = stream.random_range(0..concepts.len());
                        Sprite {
                            name: "",
                            kind: AgentKind::ALL[stream.random_range(0..2)],
                            kind_name: None,
                            concepts: &concepts[first..stream.random_range(first..=concepts.len())],
                            at: Cell::new(
                                corner.row + stream.random_range(-4..18),
                                corner.col + stream.random_range(-4..15),
                            ),
                            facing: Facing::ALL[stream.random_range(0..8)],
                            instance: stream.random_range(0..3),
                            framing: placement.icons().framing(&mut stream),
                            action: None,
                        }
                    })
                    .collect();
                assert!(
                    renderer.draw(&agents).pixels() == slowly(&map, &icons, &view, look, &agents),
                    "case {case}"
                );
                assert_eq!(renderer.boxes(&agents), placement.boxes(&agents), "case {case}");
                for (agent, found) in agents.iter().zip(placement.boxes(&agents)) {
                    let expected = map.contains(agent.at).then(|| drawn(&icons(), &view, agent).1);
                    assert_eq!(found, expected.flatten(), "case {case}");
                }
                let (counts, owners) = slowly_visible(&icons(), &view, &map, &agents);
                let mask = renderer.placement.mask(&agents);
                let owners = owners.into_iter().map(|owner| owner.map_or(0, |at| at as u8 + 1));
                assert!(owners.eq(mask.iter().copied()), "case {case}");
                without_each(&renderer, &agents, &mask);
                let visible = placement.visible(&agents);
                assert_eq!(renderer.visible(&agents), visible, "case {case}");
                for (at, (shown, all)) in counts.into_iter().enumerate() {
                    let boxed = placement.boxes(&agents[at..=at])[0].is_some();
                    let fraction = boxed.then(|| shown as f32 / all.max(1) as f32);
                    assert_eq!(visible[at], fraction, "case {case}, agent {at}: {shown} of {all}");
                    covered += u32::from(shown > 0 && shown < all);
                }
            }
        }
        assert!(covered > 5, "{covered} agents are partly covered");
    }

    #[test]
    fn disjoint_rectangles_have_each_pixel_once() {
        let mut stream = Seed(4).stream(Purpose::TEST, 0, 0);
        for _ in 0..200 {
            let areas: Vec<PixelBox> = (0..stream.random_range(0..6))
                .map(|_| PixelBox {
                    x: stream.random_range(0..20),
                    y: stream.random_range(0..20),
                    width: stream.random_range(1..12),
                    height: stream.random_range(1..12),
                })
                .collect();
            let holds = |area: &PixelBox, x: i32, y: i32| {
                area.overlaps(PixelBox {
                    x,
                    y,
                    width: 1,
                    height: 1,
                })
            };
            let parts = disjoint(&areas);
            for (x, y) in (0..32).flat_map(|y| (0..32).map(move |x| (x, y))) {
                let count = parts.iter().filter(|part| holds(part, x, y)).count();
                assert_eq!(
                    count,
                    usize::from(areas.iter().any(|area| holds(area, x, y))),
                    "{areas:?}"
                );
            }
        }
    }
}
