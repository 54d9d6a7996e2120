//! What one pixel looks like: rays, march, normal, lights, materials. Written once for every back end.

mod lighting;
mod media;
mod path;
mod scene_distance;
mod shading;
mod step_budget;

use crate::animation::Still;
use crate::backgrounds::Backdrop;
use crate::bounds::Bounds;
use crate::camera::{Ray, View};
use crate::limits::MAX_SAMPLES;
use crate::march::{Approach, Marched, RELAXATION, Reach, Tolerance, find_root, march_to_root};
use crate::materials::{Material, Place, Shade};
use crate::real::{Flag, Real, Vec3, bundle, vec3};
use crate::sampling::{Dice, Jitter, frame_key};
use crate::scene::Scene;
use media::Media;
use shading::Clothes;

/// A frame of a job, ready to be asked for its pixels.
///
/// Its larger steps enter through [`Real::shared`] instead of being inlined into one another:
/// for thirty lanes a call costs little, and code for each instruction set is made once.
#[derive(Clone, Debug)]
pub struct Program<'a> {
    scene: &'a Scene,
    /// One over each object's Lipschitz factor; `None` where that is 1.
    shrink: Vec<Option<f32>>,
    /// The objects that are surfaces, by index; the others are clouds and volumes.
    surfaces: Vec<usize>,
    clothes: Clothes,
    media: Option<Media<'a>>,
    /// Whether rays go on from some surface.
    sends_on: bool,
    /// Whether rays go through some surface.
    lets_through: bool,
    /// Boxes of objects that need not be looked at from far away; empty if there are none.
    boxes: Vec<Option<Bounds>>,
    /// Whether its distance is so long that all who ask for it share one that also names the object.
    is_long: bool,
    /// Holds all there is to see.
    bounds: Bounds,
    view: View,
    samples: u32,
    frame_key: u32,
    tolerance: Tolerance,
    resolution: Tolerance,
    /// Half the edge of the tetrahedron that normals are measured on, at most.
    tap: Tolerance,
    /// Half of what a sample sees: of a pixel's height, over the root of their number.
    seen: Tolerance,
    /// Surfaces whose normals are means over a pixel.
    fine: Vec<usize>,
}

/// From so many nodes on, one formula for the distance and another for the nearest object would be too much text.
const LONG_SCENE_NODES: u32 = 32;

/// The colour of a pixel.
#[derive(Clone, Copy, Debug)]
pub struct Radiance<R> {
    /// Linear RGB, premultiplied by alpha.
    pub color: Vec3<R>,
    /// Coverage, where the background is transparent; else 1.
    pub alpha: R,
    /// How often the scene's distance was evaluated.
    pub evaluations: R,
}

/// What the ray through a pixel's centre meets.
#[derive(Clone, Copy, Debug)]
pub struct Met<R> {
    /// Distance along the ray; infinite where nothing is hit.
    pub depth: R,
    /// Normal, towards the viewer's side; 0 where nothing is hit.
    pub normal: Vec3<R>,
    /// Where; 0 where nothing is hit.
    pub position: Vec3<R>,
    /// The surface's own colour; 0 where nothing is hit.
    pub albedo: Vec3<R>,
    /// Index of the object; −1 where nothing is hit.
    pub object: R,
    /// Steps of the march.
    pub steps: R,
}

/// A place on a surface.
#[derive(Clone, Copy)]
struct Hit<R: Real> {
    distance: R,
    position: Vec3<R>,
    normal: Vec3<R>,
    /// Whether the surface is seen from inside.
    inside: Flag<R>,
}

bundle!(Radiance { color, alpha, evaluations });
bundle!(Hit { distance, position, normal, inside });

impl<R: Real> Place<R> {
    #[inline(always)]
    fn of(hit: &Hit<R>, ray: &Ray<R>, footprint: [Vec3<R>; 2]) -> Self {
        Self {
            footprint,
            normal: hit.normal,
            to_viewer: -ray.direction,
            point: hit.position,
            own_normal: hit.normal,
            distance: hit.distance,
            inside: hit.inside,
        }
    }
}

impl<'a> Program<'a> {
    /// The picture of one frame.
    pub fn new(still: &'a Still<'_>) -> Self {
        let (scene, image, moves) = (still.scene(), still.image(), still.is_moving());
        let view = scene.camera.view(image.width, image.height);
        let clothes = Clothes::new(scene);
        let is_worn = |of: fn(&Material) -> bool| clothes.slots().any(|slot| of(&scene.slots()[slot]));
        let (sends_on, lets_through) = (is_worn(Shade::sends_on), is_worn(Shade::lets_through));
        let surfaces: Vec<usize> =
            (0..scene.objects.len()).filter(|&index| !scene.material_of(index).is_medium()).collect();
        let boxes: Vec<Option<Bounds>> =
            scene.objects.iter().map(|object| object.shape.skipping_bounds(moves)).collect();
        let shapes = surfaces.iter().map(|&index| scene.objects[index].shape.bounds(0.0));
        let bounds = shapes.reduce(Bounds::hull).unwrap_or(Bounds::NOWHERE);
        Self {
            scene,
            boxes: if boxes.iter().all(Option::is_none) { Vec::new() } else { boxes },
            is_long: scene.nodes() >= LONG_SCENE_NODES,
            bounds: bounds.with_margin(view.origin()),
            shrink: scene.objects.iter().map(|object| shrink(object.shape.stretch(), moves)).collect(),
            media: Media::new(scene, view.origin()),
            sends_on,
            lets_through,
            clothes,
            fine: surfaces.iter().copied().filter(|&index| scene.objects[index].shape.is_fine()).collect(),
            surfaces,
            tolerance: view.tolerance(),
            resolution: view.resolution(),
            tap: view.tap(),
            seen: view.footprint().scaled(1.0 / Real::sqrt(image.samples as f32)),
            view,
            samples: image.samples,
            frame_key: frame_key(image.seed, still.frame()),
        }
    }

    /// The colour of the pixel in column `x` and row `y`, both whole.
    #[inline(always)]
    pub fn pixel<R: Real>(&self, x: R, y: R) -> Radiance<R> {
        let zero = x.splat(0.0);
        let nothing = Radiance { color: vec3(zero, zero, zero), alpha: zero, evaluations: zero };
        self.mean(self.accumulate(x, y, zero, x.splat(self.samples as f32), nothing))
    }

    /// `sum` and the light of more of a pixel's samples: from `first`, until before `end`, which is
    /// above `first`. Sums of parts, in order, have the same bits as one sum of all.
    pub fn accumulate<R: Real>(&self, x: R, y: R, first: R, end: R, sum: Radiance<R>) -> Radiance<R> {
        x.vectorize(
            #[inline(always)]
            || {
                let add = |sum: Radiance<R>, seen: Radiance<R>| Radiance {
                    color: sum.color + seen.color,
                    alpha: sum.alpha + seen.alpha,
                    evaluations: sum.evaluations + seen.evaluations,
                };
                let zero = x.splat(0.0);
                let dice = Dice { x, y, sample: zero, bounce: zero, frame_key: self.frame_key };
                if self.samples == 1 {
                    return add(sum, self.radiance(x + 0.5, y + 0.5, &dice));
                }
                let jitter = Jitter::new(x, y, self.frame_key);
                let (_, sum) = R::repeat(
                    MAX_SAMPLES,
                    (first, sum),
                    #[inline(always)]
                    |(sample, sum)| {
                        let (jx, jy) = jitter.offset(sample);
                        let next = sample + 1.0;
                        let seen = self.radiance(x + jx, y + jy, &Dice { sample, ..dice });
                        (next.lt(end), (next, add(sum, seen)))
                    },
                );
                sum
            },
        )
    }

    /// The colour of a pixel whose samples are all in `sum`.
    #[inline(always)]
    pub fn mean<R: Real>(&self, sum: Radiance<R>) -> Radiance<R> {
        if self.samples == 1 {
            return sum;
        }
        let share = sum.alpha.given(1.0 / self.samples as f32);
        Radiance { color: sum.color * share, alpha: sum.alpha * share, evaluations: sum.evaluations }
    }

    /// What the ray through the centre of the pixel in column `x` and row `y` meets.
    pub fn layers<R: Real>(&self, x: R, y: R) -> Met<R> {
        x.vectorize(
            #[inline(always)]
            || {
                let ray = self.view.ray(x + 0.5, y + 0.5);
                let marched = if self.fine.is_empty() { self.march(&ray) } else { self.march_to_depth(&ray) };
                let zero = x.splat(0.0);
                let nothing = vec3(zero, zero, zero);
                let missed = (x.splat(f32::INFINITY), nothing, nothing, nothing, zero.splat(-1.0));
                let (depth, normal, position, albedo, object) = R::when(
                    marched.hit.0,
                    missed,
                    #[inline(always)]
                    || {
                        let hit = self.hit(&ray, &marched);
                        let object = self.nearest(hit.position).1;
                        let albedo = self.albedo(&hit, &ray, object);
                        (hit.distance, hit.normal, ray.at(hit.distance), albedo, object)
                    },
                );
                Met { depth, normal, position, albedo, object, steps: marched.steps }
            },
        )
    }

    /// The light along the ray through a point of the picture, in pixels from its top left.
    fn radiance<R: Real>(&self, x: R, y: R, dice: &Dice<R>) -> Radiance<R> {
        x.vectorize(
            #[inline(always)]
            || {
                let ray = self.view.ray(x, y);
                if self.sends_on || self.media.is_some() || self.scene.fog.is_some() {
                    return self.path(&ray, dice);
                }
                let marched = self.march(&ray);
                let (background, alpha) = self.background(ray.direction);
                let (color, alpha, evaluations) = R::when(
                    marched.hit.0,
                    (background, alpha, marched.steps),
                    #[inline(always)]
                    || {
                        let (color, evaluations) = self.surface(&ray, &marched, dice);
                        (color, x.splat(1.0), marched.steps + evaluations)
                    },
                );
                Radiance { color, alpha, evaluations }
            },
        )
    }

    /// What is seen where nothing is, and its alpha.
    #[inline(always)]
    fn background<R: Real>(&self, direction: Vec3<R>) -> (Vec3<R>, R) {
        let alpha = if self.scene.background.is_transparent() { 0.0 } else { 1.0 };
        (self.scene.background.toward(direction), direction.x.splat(alpha))
    }

    fn march<R: Real>(&self, ray: &Ray<R>) -> Marched<R> {
        ray.direction.x.shared(
            "march",
            *ray,
            #[inline(always)]
            |ray| {
                let Tolerance { slope, floor } = self.tolerance;
                self.march_within(&ray, ray.direction.x.given(slope), ray.direction.x.given(floor), false)
            },
        )
    }

    /// The same to a root of surfaces with details of every size, too: a way that only depth is worth.
    fn march_to_depth<R: Real>(&self, ray: &Ray<R>) -> Marched<R> {
        ray.direction.x.shared(
            "march_to_depth",
            *ray,
            #[inline(always)]
            |ray| {
                let Tolerance { slope, floor } = self.tolerance;
                self.march_within(&ray, ray.direction.x.given(slope), ray.direction.x.given(floor), true)
            },
        )
    }

    /// Marches within the scene's bounds; what is near enough grows by `slope` from `near`. To be near enough is
    /// to have met a surface with details of every size, unless its `depth` is asked for.
    #[inline(always)]
    fn march_within<R: Real>(&self, ray: &Ray<R>, slope: R, near: R, depth: bool) -> Marched<R> {
        let approach = self.approach(slope, near, depth);
        let zero = ray.direction.x.splat(0.0);
        let farthest = zero.given(self.scene.march.max_distance.get());
        let (nearest, farthest) = self.bounds.along(ray, farthest);
        let missed =
            Marched { distance: farthest, near: farthest, gap: farthest, steps: zero, hit: Flag(zero.below(0.0)) };
        R::when(
            nearest.lt(farthest),
            missed,
            #[inline(always)]
            || {
                // Depth among details takes many steps of a distance that is next to none.
                let (times, relaxation) = if depth { (16, 1.0) } else { (1, RELAXATION) };
                let max_steps = self.scene.march.max_steps * times;
                let reach = Reach { nearest, farthest, max_steps, relaxation };
                let marched = march_to_root(
                    ray,
                    reach,
                    approach,
                    #[inline(always)]
                    |p| self.distance(p),
                    #[inline(always)]
                    |p| self.is_fine(p),
                );
                // Out of steps: a hit if what the pixel sees touches the surface.
                let seen = self.view.footprint().at(marched.distance);
                let touches = !marched.hit.0 & marched.gap.lt(seen) & marched.distance.lt(farthest);
                if !self.fine.is_empty() {
                    return Marched { hit: Flag(marched.hit.0 | touches), ..marched };
                }
                // And if there is a root: a ray along a surface has none.
                let wide = Approach { slope: zero, near: seen, ..approach };
                R::when(
                    touches,
                    marched,
                    #[inline(always)]
                    || {
                        find_root(
                            ray,
                            &marched,
                            wide,
                            None,
                            #[inline(always)]
                            |p| self.distance(p),
                        )
                    },
                )
            },
        )
    }

    #[inline(always)]
    fn approach<R>(&self, slope: R, near: R, among_details: bool) -> Approach<R> {
        Approach { slope, near, resolution: self.resolution, both_sides: self.lets_through, among_details }
    }

    /// Where exactly a march that came near the surface meets it, and the normal there.
    fn hit<R: Real>(&self, ray: &Ray<R>, marched: &Marched<R>) -> Hit<R> {
        marched.distance.shared(
            "hit",
            (*ray, *marched),
            #[inline(always)]
            |(ray, marched)| {
                let Marched { distance: root, near, gap, .. } = marched;
                let fine = self.is_fine(ray.at(near));
                let from = fine.map_or(root, |fine| R::select(fine, near, root));
                let p = ray.at(from);
                let normal = self.normal(p, self.tap(p, from, fine));
                let facing = -normal.dot(ray.direction);
                let steepness = if self.lets_through { facing.abs() } else { facing };
                // One step of Newton's method along the ray; cautious where it grazes the surface.
                let about = (near + gap / steepness.at_least(0.25)).at_least(0.0);
                // Where the march ran out of steps there is no root.
                let distance = R::select(near.lt(root) | root.lt(near), root, about);
                let position = ray.at(fine.map_or(distance, |fine| R::select(fine, about, distance)));
                let inside = facing.below(0.0);
                let normal = Vec3::select(inside, -normal, normal);
                Hit { distance, position, normal, inside: Flag(inside) }
            },
        )
    }

    /// Whether the surface at `p` has details of every size; `None` where none has. Among them a root is one of
    /// many: what is seen is the surface at the march's tolerance around them, and its normal is the mean over a pixel.
    #[inline(always)]
    fn is_fine<R: Real>(&self, p: Vec3<R>) -> Option<R::Mask> {
        let zero = p.x.splat(0.0);
        if self.fine.is_empty() || self.fine.len() == self.surfaces.len() {
            return (!self.fine.is_empty()).then(|| zero.below(1.0));
        }
        let object = self.nearest(p).1;
        let nowhere = zero.above(1.0);
        Some(self.fine.iter().fold(
            nowhere,
            #[inline(always)]
            |mask, &index| mask | (object - index as f32).abs().below(0.5),
        ))
    }

    /// How far from a hit its normal is measured: as little as `f32` allows, so that no edge nearby is seen; but
    /// half of half a pixel where the surface has finer details.
    #[inline(always)]
    fn tap<R: Real>(&self, p: Vec3<R>, distance: R, fine: Option<R::Mask>) -> R {
        /// Of a coordinate: some thousand times what it is right to.
        const OF_COORDINATE: f32 = 2.5e-4;
        /// Of what is the most: a fortieth of half a pixel.
        const OF_MOST: f32 = 0.05;
        let most = self.tap.at(distance);
        let size = vec3(p.x.abs(), p.y.abs(), p.z.abs()).max_element();
        let least = distance.given(self.resolution.floor * 50.0);
        let sharp = (size * OF_COORDINATE).max(most * OF_MOST).max(least).min(most);
        fine.map_or(sharp, |fine| R::select(fine, most, sharp))
    }

    /// The gradient's direction, from four taps on a tetrahedron.
    #[inline(always)]
    #[expect(
        clippy::redundant_closure_for_method_calls,
        reason = "a closure can be inlined always, a method named can't"
    )]
    fn normal<R: Real>(&self, p: Vec3<R>, size: R) -> Vec3<R> {
        let a = self.distance(p + vec3(size, -size, -size));
        let b = self.distance(p + vec3(-size, -size, size));
        let c = self.distance(p + vec3(-size, size, -size));
        let d = self.distance(p + vec3(size, size, size));
        let (ad, bc) = (a + d, b + c);
        let (ca, db) = (c - a, d - b);
        // Scaled up, so that the squares of small differences do not vanish.
        let gradient = vec3(ad - bc, ca + db, (d - c) + (b - a));
        let largest = gradient
            .map(
                #[inline(always)]
                |c| c.abs(),
            )
            .max_element()
            .at_least(1e-20);
        (gradient * (size.splat(1.0) / largest)).normalize()
    }
}

/// What an object's distance is multiplied by: nothing if it is 1, but in all frames alike.
fn shrink(stretch: f32, moves: bool) -> Option<f32> {
    (stretch != 1.0 || moves).then(|| 1.0 / stretch)
}
