//! Integrator: computes the color of a pixel from rays, march, normal, lights and materials. Written once for all
//! devices.

mod brightness_levels;
mod by_cells;
mod colors;
mod coverage;
mod emitters;
mod grouped_light;
mod guides;
mod light_path;
mod lighting;
mod marching;
mod media;
mod media_path;
mod motion;
mod path;
mod pick;
mod ray_boxes;
mod ray_density;
mod ray_kinds;
mod regeneration;
mod scene_distance;
mod shading;
mod sky_table;
mod step_budget;
mod straight_shadows;

use std::ops::{Add, Range};

use crate::animation::JobAtFrame;
use crate::bounds::Bounds;
use crate::camera::View;
use crate::cells::Cells;
use crate::film::{BRIGHTNESS_LEVELS, ImageSpec};
use crate::limits::MAX_SAMPLES;
use crate::march::{MAX_PAST, MAX_PAST_FRACTALS};
use crate::materials::{Material, ShadingPoint};
use crate::ray::{Ray, Tolerance};
use crate::real::{MaskValue, Real, Vec3, bundle, vec3};
use crate::sample_count::{BATCH, within_batches};
use crate::sampling::{PixelSampler, Sampler, frame_key};
use crate::scene::Scene;
use crate::transport::{PathSettings, Transport};
use crate::visible::RayKind;
use crate::visits::Visits;
pub use brightness_levels::{LEAST_BRIGHTNESS, LEVEL_RATIO, LeveledLight};
pub use by_cells::{compiled_nodes, frame_compiled_nodes};
use coverage::MatteIds;
pub use coverage::{Coverage, MAX_COVERAGE_SAMPLES, RANKS, Rank, Ranks};
use emitters::Emitters;
use grouped_light::GroupPlaces;
pub use grouped_light::GroupedLight;
pub use guides::Guides;
use media::Media;
use motion::NextFrame;
use ray_boxes::RayBoxes;
pub use regeneration::{Lane, MarchedRay, PathSteps};
use shading::MaterialTable;

/// A frame of a job, prepared for rendering its pixels.
///
/// Its larger steps go through [`Real::call`] instead of being inlined into one another: for thirty lanes a call costs
/// little, and the code of each instruction set is generated once.
#[derive(Clone, Debug)]
pub struct Integrator<'a> {
    scene: &'a Scene,
    /// Step scale of each object; `None` if it is 1.
    step_scales: Vec<Option<f32>>,
    /// Indices of the objects that are surfaces; the others are clouds and volumes.
    surfaces: Vec<usize>,
    materials: MaterialTable,
    media: Option<Media<'a>>,
    /// The lights, and the objects that shine.
    emitters: Emitters,
    /// The picture's light groups, if it has any.
    light_groups: Option<GroupPlaces>,
    /// Number of levels of brightness by which light is summed, too.
    levels: usize,
    /// Whether some surface reflects or transmits rays.
    sends_on: bool,
    /// Whether some surface transmits rays.
    lets_through: bool,
    /// Boxes of objects that are skipped when they are distant; empty if there are none.
    cull_bounds: Vec<Option<Bounds>>,
    /// Boxes of large objects, which marches evaluate only there; `None` if there are none.
    ray_boxes: Option<RayBoxes>,
    /// Whether all callers share one distance function, which also returns the nearest object, because the formula is
    /// long.
    shares_nearest: bool,
    /// Bounds of all surfaces.
    bounds: Bounds,
    view: View,
    /// Column and row of the picture's top left in the whole picture.
    origin: [u32; 2],
    samples: u32,
    frame_key: u32,
    tolerance: Tolerance,
    resolution: Tolerance,
    /// Maximum of half the edge of the tetrahedron for normals.
    normal_epsilon: Tolerance,
    /// Half the height that a sample covers: half a pixel's height over the square root of the least number of samples.
    seen: Tolerance,
    /// Limit of the steps of marches, see [`crate::march::MarchRange::max_past`].
    max_past: f32,
    /// Indices of the surfaces with fine detail, whose normals are averaged over a pixel.
    fine: Vec<usize>,
    /// The surfaces' cells, in a picture of many shapes.
    cells: Option<Cells<'a>>,
    /// The next frame, if the picture shows motion.
    next_frame: Option<NextFrame<'a>>,
    /// The ids of the picture's mattes.
    matte_ids: MatteIds,
    /// Record of what rays ask for, if that is wanted.
    visits: Option<Visits>,
    /// The rays that are followed: they see other objects than other kinds do.
    rays: RayKind,
    /// The scene as shadow rays see it, if they see other objects.
    of_shadows: Option<Box<Self>>,
    /// The scene as reflected and refracted rays see it, if they see other objects.
    of_reflections: Option<Box<Self>>,
}

/// From this number of nodes on, separate formulas for the distance and for the nearest object would be too much code.
const SHARED_DISTANCE_NODES: u32 = 32;

/// The color of a pixel.
#[derive(Clone, Copy, Debug)]
pub struct Radiance<R> {
    /// Linear RGB, premultiplied by alpha.
    pub color: Vec3<R>,
    /// Coverage if the background is transparent; else 1.
    pub alpha: R,
    /// The same light by the picture's light groups.
    pub groups: GroupedLight<R>,
    /// The same light by the brightness of the samples.
    pub levels: LeveledLight<R>,
    /// Number of evaluations of the scene's distance, alone or with the nearest object: for marches, searches for
    /// roots, normals, shadows, ambient occlusion and materials. Distances of a single object are not counted.
    pub evaluations: R,
}

/// Layer (AOV) values at a pixel's center.
#[derive(Clone, Copy, Debug)]
pub struct LayerValues<R> {
    /// Distance along the ray; infinite where nothing is hit.
    pub depth: R,
    /// Normal, toward the viewer's side; 0 where nothing is hit.
    pub normal: Vec3<R>,
    /// Position; 0 where nothing is hit.
    pub position: Vec3<R>,
    /// Albedo; 0 where nothing is hit.
    pub albedo: Vec3<R>,
    /// Index of the object; −1 where nothing is hit.
    pub object: R,
    /// Steps of the march.
    pub steps: R,
    /// Greatest number of samples of the pixel.
    pub samples: R,
    /// The way in the picture until the next frame, in pixels to the right and up.
    pub motion: (R, R),
}

/// A hit: a point on a surface.
#[derive(Clone, Copy)]
struct Hit<R: Real> {
    t: R,
    position: Vec3<R>,
    normal: Vec3<R>,
    /// Whether the ray hit the surface from inside.
    is_inside: MaskValue<R>,
}

bundle!(Radiance { color, alpha, groups, levels, evaluations });

impl<R: Real> Radiance<R> {
    /// Its channels, see `Film::sum_channels`.
    pub fn channels(self) -> Vec<R> {
        let Self { color, alpha, groups, levels, evaluations: _ } = self;
        [color.x, color.y, color.z, alpha].into_iter().chain(groups.numbers()).chain(levels.numbers()).collect()
    }
}

impl<R: Real> Add for Radiance<R> {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            color: self.color + other.color,
            alpha: self.alpha + other.alpha,
            groups: self.groups + other.groups,
            levels: self.levels + other.levels,
            evaluations: self.evaluations + other.evaluations,
        }
    }
}
bundle!(Hit { t, position, normal, is_inside });

/// The point of a hit, as materials see it.
fn shading_point<R: Real>(hit: &Hit<R>, ray: &Ray<R>, footprint: [Vec3<R>; 2]) -> ShadingPoint<R> {
    ShadingPoint {
        footprint,
        normal: hit.normal,
        to_viewer: -ray.direction,
        local_point: hit.position,
        local_normal: hit.normal,
        camera_t: hit.t,
        is_inside: hit.is_inside,
    }
}

impl<'a> Integrator<'a> {
    /// Prepares the integrator for one frame, without cells: every formula is written out.
    pub fn new(at_frame: &'a JobAtFrame<'_>) -> Self {
        let scene = at_frame.scene();
        let seen_by = |rays| Self::seen_by(at_frame, rays);
        let differ = |one, other| scene.objects.iter().any(|object| object.visible.to(one) != object.visible.to(other));
        let of_shadows = |rays| differ(rays, RayKind::Shadow).then(|| Box::new(seen_by(RayKind::Shadow)));
        let of_reflections = differ(RayKind::Camera, RayKind::Reflection).then(|| {
            let of_shadows = of_shadows(RayKind::Reflection);
            Box::new(Self { of_shadows, ..seen_by(RayKind::Reflection) })
        });
        Self { of_shadows: of_shadows(RayKind::Camera), of_reflections, ..seen_by(RayKind::Camera) }
    }

    /// Prepares the integrator for one frame and the objects that rays of a kind see.
    fn seen_by(at_frame: &'a JobAtFrame<'_>, rays: RayKind) -> Self {
        let (scene, image, moves) = (at_frame.scene(), at_frame.image(), at_frame.is_animated());
        let &ImageSpec { width, height, .. } = image;
        let view = scene.camera.view(width, height);
        let table = MaterialTable::new(scene);
        let is_any = |of: fn(&Material) -> bool| table.slots().any(|slot| of(&scene.used_materials()[slot]));
        let (sends_on, lets_through) = (is_any(Material::is_specular), is_any(Material::is_transmissive));
        let surfaces: Vec<usize> = surfaces_of(scene).filter(|&index| scene.objects[index].visible.to(rays)).collect();
        let boxes: Vec<Option<Bounds>> =
            scene.objects.iter().map(|object| object.shape.culling_bounds(moves)).collect();
        let shapes = surfaces.iter().map(|&index| scene.objects[index].shape.bounds(0.0));
        let bounds = shapes.reduce(Bounds::union).unwrap_or(Bounds::EMPTY);
        let step_scales: Vec<Option<f32>> =
            scene.objects.iter().map(|object| shrink(object.shape.lipschitz(), moves)).collect();
        let bounds = view.with_margin(bounds);
        let has_fractal = surfaces.iter().any(|&index| scene.objects[index].shape.has_fractal());
        let ray_boxes = RayBoxes::new(scene, &surfaces, &boxes, view.resolution().floor);
        Self {
            scene,
            cells: None,
            next_frame: NextFrame::of(at_frame),
            matte_ids: MatteIds::of(at_frame),
            visits: None,
            rays,
            of_shadows: None,
            of_reflections: None,
            cull_bounds: if boxes.iter().all(Option::is_none) { Vec::new() } else { boxes },
            ray_boxes,
            shares_nearest: scene.nodes() >= SHARED_DISTANCE_NODES,
            bounds,
            step_scales,
            media: Media::new(scene, rays, &view),
            emitters: Emitters::new(scene, &surfaces),
            light_groups: at_frame.light_groups().map(GroupPlaces::new),
            levels: if image.is_reweighted() { BRIGHTNESS_LEVELS } else { 0 },
            sends_on,
            lets_through,
            materials: table,
            max_past: if has_fractal { MAX_PAST_FRACTALS } else { MAX_PAST },
            fine: surfaces.iter().copied().filter(|&index| scene.objects[index].shape.is_fine()).collect(),
            surfaces,
            tolerance: view.tolerance(),
            resolution: view.resolution(),
            normal_epsilon: view.normal_epsilon(),
            seen: view.footprint().scaled(1.0 / Real::sqrt(image.samples.min() as f32)),
            view,
            origin: image.film().origin,
            samples: image.samples.max(),
            frame_key: frame_key(image.seed, at_frame.frame()),
        }
    }

    /// Color of the pixel in column `x` and row `y`, both integers.
    pub fn pixel<R: Real>(&self, x: R, y: R) -> Radiance<R> {
        let zero = x.constant(0.0);
        let batch = |samples: Range<u32>| {
            let [first, end] = [samples.start, samples.end].map(|sample| x.constant(sample as f32));
            self.accumulate(x, y, first, end, self.no_light(zero))
        };
        let sum = within_batches(0..self.samples, BATCH).map(batch).reduce(|sum, batch| sum + batch);
        self.mean(sum.expect("a pixel has a sample"))
    }

    /// A sum of no samples.
    pub fn no_light<R: Real>(&self, zero: R) -> Radiance<R> {
        let (color, groups) = (vec3(zero, zero, zero), self.no_grouped_light(zero));
        Radiance { color, alpha: zero, groups, levels: self.leveled(color), evaluations: zero }
    }

    /// The sum with these channels (`Film::sum_channels`), without counted evaluations.
    pub fn sum_of_channels<R: Real>(&self, channels: &[R]) -> Radiance<R> {
        let &[red, green, blue, alpha, ref parts @ ..] = channels else { panic!("a sum has its channels") };
        let (groups, levels) = parts.split_at(3 * self.group_count());
        let (groups, levels) = (GroupedLight::from_numbers(groups), LeveledLight::from_numbers(levels));
        Radiance { color: vec3(red, green, blue), alpha, groups, levels, evaluations: alpha.constant(0.0) }
    }

    /// Adds samples of a [batch](BATCH) to the sum of those before in it: from `first` up to but excluding `end`, which is
    /// greater than `first`. Adding in parts, in order, gives bit-identical sums.
    pub fn accumulate<R: Real>(&self, x: R, y: R, first: R, end: R, sum: Radiance<R>) -> Radiance<R> {
        if let Some(paths) = self.path_steps() {
            return paths.accumulate([x, y], [first, end], sum);
        }
        let pixel = self.pixel_sampler(x, y);
        if self.samples == 1 {
            return sum + self.radiance(&pixel, &pixel.sample(x.constant(0.0)));
        }
        let (_, sum) = R::repeat(MAX_SAMPLES, (first, sum), |(sample, sum)| {
            let next = sample + 1.0;
            (next.lt(end), (next, sum + self.radiance(&pixel, &pixel.sample(sample))))
        });
        sum
    }

    /// Sampler of the pixel in this column and row of what is rendered.
    fn pixel_sampler<R: Real>(&self, x: R, y: R) -> PixelSampler<R> {
        let [x, y] = self.in_whole_picture(x, y);
        PixelSampler::new(x, y, self.samples, self.frame_key)
    }

    /// Column and row in the whole picture, even if only a region is rendered.
    fn in_whole_picture<R: Real>(&self, x: R, y: R) -> [R; 2] {
        let moved = |number: R, by: u32| if by == 0 { number } else { number + by as f32 };
        [moved(x, self.origin[0]), moved(y, self.origin[1])]
    }

    /// Color of a pixel whose samples have all been added to `sum`.
    pub fn mean<R: Real>(&self, sum: Radiance<R>) -> Radiance<R> {
        if self.samples == 1 {
            return sum;
        }
        let share = sum.alpha.uniform(1.0 / self.samples as f32);
        Radiance {
            color: sum.color * share,
            alpha: sum.alpha * share,
            groups: sum.groups * share,
            levels: sum.levels * share,
            evaluations: sum.evaluations,
        }
    }

    /// Layer (AOV) values of the ray through the center of the pixel in column `x` and row `y`.
    pub fn layer_values<R: Real>(&self, x: R, y: R) -> LayerValues<R> {
        let [x, y] = self.in_whole_picture(x, y);
        let ray = self.view.ray(x + 0.5, y + 0.5);
        let marched = if self.fine.is_empty() { self.march(&ray) } else { self.march_to_depth(&ray) };
        let zero = x.constant(0.0);
        let nothing = vec3(zero, zero, zero);
        let background = self.background_motion(&ray);
        let missed = (x.constant(f32::INFINITY), nothing, nothing, nothing, zero.constant(-1.0), background);
        let (depth, normal, position, albedo, object, motion) = R::when(marched.hit.0, missed, || {
            let hit = self.hit(&ray, &marched);
            let object = self.nearest_object(hit.position).1;
            let albedo = self.albedo(&hit, &ray, object);
            (hit.t, hit.normal, ray.at(hit.t), albedo, object, self.surface_motion(&hit, object))
        });
        let samples = x.uniform(self.samples as f32);
        let motion = motion.unwrap_or((zero, zero));
        LayerValues { depth, normal, position, albedo, object, steps: marched.steps, samples, motion }
    }

    /// Ray of a sample of a pixel: through its center if it is the only one.
    fn ray_of_sample<R: Real>(&self, pixel: &PixelSampler<R>, sampler: &Sampler<R>) -> Ray<R> {
        let [x, y] = pixel.pixel();
        let (jx, jy) =
            if self.samples == 1 { (x.constant(0.5), x.constant(0.5)) } else { sampler.get_2d(lighting::IN_PIXEL) };
        self.view.ray_through_lens(x + jx, y + jy, || sampler.get_2d(lighting::ON_LENS))
    }

    /// Radiance along the ray of a sample of a pixel.
    fn radiance<R: Real>(&self, pixel: &PixelSampler<R>, sampler: &Sampler<R>) -> Radiance<R> {
        let ray = self.ray_of_sample(pixel, sampler);
        let zero = ray.direction.x.constant(0.0);
        if let Transport::Path(PathSettings { max_bounces, straight_shadows: _ }) = self.scene.integrator {
            return self.light_path(&ray, max_bounces, sampler);
        }
        if self.sends_on || self.materials.catches_shadows || self.media.is_some() || self.scene.fog.is_some() {
            return self.path(&ray, sampler);
        }
        let marched = self.march(&ray);
        let (background, alpha) = self.background(ray.direction);
        let (color, alpha, evaluations) = R::when(marched.hit.0, (background, alpha, marched.evaluations), || {
            let (color, evaluations) = self.surface(&ray, &marched, sampler);
            (color, zero.constant(1.0), marched.evaluations + evaluations)
        });
        let farthest = zero.uniform(self.scene.march.max_distance.get());
        let (color, alpha) = match self.seen_light(&ray, R::select(marched.hit.0, marched.t, farthest)) {
            None => (color, alpha),
            Some((is_seen, _, light)) => {
                (Vec3::select(is_seen, light, color), R::select(is_seen, zero.constant(1.0), alpha))
            }
        };
        Radiance { color, alpha, groups: GroupedLight::none(), levels: LeveledLight::none(), evaluations }
    }

    /// Radiance of the background along a ray, and its alpha.
    fn background<R: Real>(&self, direction: Vec3<R>) -> (Vec3<R>, R) {
        let alpha = if self.scene.background.is_transparent() { 0.0 } else { 1.0 };
        (self.scene.background.radiance(direction), direction.x.constant(alpha))
    }

    /// Radiance that a ray meets behind all surfaces: of the environment if surfaces have deflected it, so that
    /// nothing straight behind is seen, else of the background.
    fn radiance_behind<R: Real>(&self, direction: Vec3<R>, background_weight: R) -> Vec3<R> {
        let background = self.scene.background.radiance(direction);
        match &self.scene.environment {
            Some(environment) if self.sends_on => {
                Vec3::select(background_weight.above(0.0), background, environment.radiance(direction))
            }
            _ => background,
        }
    }
}

/// Box of the points of most rays: of all that start in finite bounds.
fn reach(bounds: Bounds, view: &View, farthest: f32) -> Bounds {
    let origin = view.origin();
    let around = Bounds { min: origin, max: origin }.expanded(2.0 * farthest + view.lens_radius());
    bounds.intersection(around)
}

/// Indices of the objects that are surfaces.
fn surfaces_of(scene: &Scene) -> impl Iterator<Item = usize> + '_ {
    (0..scene.objects.len()).filter(|&index| !scene.material_of(index).is_medium())
}

/// Factor of an object's distance, `None` if it is 1 in all frames.
fn shrink(lipschitz: f32, moves: bool) -> Option<f32> {
    (lipschitz != 1.0 || moves).then(|| 1.0 / lipschitz)
}
