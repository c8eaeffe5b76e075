//! The flows of `bench step`: fixed, named, in sizes from a thousand to a million particles.

use greenwater::case::{AnySetup, Case};
use greenwater::scheme::MethodName;

use super::BenchError;

/// Where the water is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Geometry {
    /// A column 1 m wide and 2 m high in a tank of 4 m x 3 m: that of the DualSPHysics example of two dimensions.
    Plane,
    /// The same column in a tank of 4 m x 4 m: the dam break of the PySPH examples.
    Square,
    /// A column of 0.4 m x 0.67 m x 0.3 m in a tank of 1.6 m x 0.67 m x 0.4 m with a post of 0.12 m: that of the DualSPHysics example of
    /// three dimensions, on the nearest lattice.
    Post,
}

/// A flow to measure.
#[derive(Clone, Copy, Debug)]
pub struct Flow {
    /// Its name.
    pub name: &'static str,
    /// The method.
    pub method: MethodName,
    /// Where the water is.
    pub geometry: Geometry,
    /// Particles across the width of the column: its spacing.
    pub columns: u32,
    /// Steps before the first timed one.
    pub warm_up: u32,
    /// Whether it is measured with `--quick`.
    pub quick: bool,
    /// A whole second of the flow is timed instead of some steps.
    pub second: bool,
}

const fn delta(name: &'static str, geometry: Geometry, columns: u32, warm_up: u32, quick: bool) -> Flow {
    Flow { name, method: MethodName::DeltaSph, geometry, columns, warm_up, quick, second: false }
}

const fn isph(name: &'static str, columns: u32, warm_up: u32, quick: bool) -> Flow {
    Flow { name, method: MethodName::Isph, geometry: Geometry::Square, columns, warm_up, quick, second: false }
}

/// All of them. Columns are chosen so that fluid and walls together have the number of particles in the name.
pub static FLOWS: [Flow; 13] = [
    delta("dam-break-2d-10k", Geometry::Plane, 64, 10, true),
    delta("dam-break-2d-50k", Geometry::Plane, 151, 5, false),
    delta("dam-break-2d-200k", Geometry::Plane, 309, 3, false),
    delta("dam-break-2d-1m", Geometry::Plane, 700, 1, false),
    delta("dam-break-3d-35k", Geometry::Post, 20, 5, false),
    delta("dam-break-3d-300k", Geometry::Post, 49, 1, false),
    isph("dam-break-isph-1k4", 19, 10, true),
    isph("dam-break-isph-5k", 42, 10, true),
    isph("dam-break-isph-20k", 91, 5, false),
    isph("dam-break-isph-101k", 216, 3, false),
    isph("dam-break-isph-1m", 698, 1, false),
    Flow { second: true, ..delta("dam-break-2d-second", Geometry::Plane, 66, 0, false) },
    Flow { second: true, ..isph("dam-break-isph-second", 36, 0, false) },
];

impl Flow {
    /// Dimensions of space.
    pub fn dimension(&self) -> u32 {
        if self.geometry == Geometry::Post { 3 } else { 2 }
    }

    /// The checked case.
    pub fn setup(&self) -> Result<AnySetup, BenchError> {
        Ok(Case::parse(self.name, self.case(), None, &[])?.checked()?)
    }

    /// The text of the case.
    fn case(&self) -> String {
        let (shapes, walls, spacing) = match self.geometry {
            Geometry::Plane | Geometry::Square => {
                let dx = 1.0 / f64::from(self.columns);
                let height = if self.geometry == Geometry::Plane { 3.0 } else { 4.0 };
                (
                    "[{ box = { min = [0.0, 0.0], max = [1.0, 2.0] } }]".to_owned(),
                    format!("[{{ tank = {{ min = [0.0, 0.0], max = [4.0, {height:?}], open = [\"top\"] }} }}]"),
                    dx,
                )
            }
            Geometry::Post => {
                let dx = 0.4 / f64::from(self.columns);
                let on = |length: f64| (length / dx).round() * dx;
                let (wide, high, at, to) = (on(0.67), on(0.3), on(0.9), on(0.9) + on(0.12));
                let (near, far) = (on(0.24), on(0.24) + on(0.12));
                (
                    format!("[{{ box = {{ min = [0.0, 0.0, 0.0], max = [0.4, {wide:?}, {high:?}] }} }}]"),
                    format!(
                        "[{{ tank = {{ min = [0.0, 0.0, 0.0], max = [1.6, {wide:?}, 0.4], open = [\"top\"] }} }}, \
                         {{ box = {{ min = [{at:?}, {near:?}, 0.0], max = [{to:?}, {far:?}, 0.4] }} }}]"
                    ),
                    dx,
                )
            }
        };
        // The kernel and the dissipation of the measured examples; c0 = 20 sqrt(g H) is ten times the default reference speed.
        let method = match (self.method, self.geometry) {
            (MethodName::DeltaSph, Geometry::Post) => {
                "name = \"delta-sph\"\nalpha = 0.02\ndelta = 0.1\nsound_factor = 10.0\n\n[kernel]\nname = \"wendland-c2\"\nh_over_spacing = 1.732"
            }
            (MethodName::DeltaSph, _) => {
                "name = \"delta-sph\"\nalpha = 0.02\ndelta = 0.1\nsound_factor = 10.0\n\n[kernel]\nname = \"wendland-c2\"\nh_over_spacing = 1.414"
            }
            _ => "name = \"isph\"",
        };
        let dimension = self.dimension();
        let name = self.name;
        format!(
            "format = 1\ntitle = \"{name}\"\ndimension = {dimension}\n\n[fluid]\nspacing = {spacing:?}\nviscosity = 0.0\nshapes = {shapes}\n\n\
             [walls]\nshapes = {walls}\n\n[method]\n{method}\n\n[time]\nend = 1.0\n"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use greenwater::with_setup;

    #[test]
    fn every_flow_is_sound_and_has_the_particles_of_its_name() {
        for flow in &FLOWS {
            // The large ones are the same cases at another spacing.
            if flow.columns > 220 {
                continue;
            }
            let setup = flow.setup().unwrap_or_else(|error| panic!("{}: {error}", flow.name));
            let particles = with_setup!(&setup, setup => setup.particles.owned());
            let size = flow.name.rsplit('-').next().expect("a size");
            let meant: f64 = match size {
                "second" => continue,
                "1k4" => 1409.0,
                size => 1e3 * size.trim_end_matches('k').parse::<f64>().expect("thousands"),
            };
            assert!((particles as f64 / meant - 1.0).abs() < 0.03, "{}: {particles} particles", flow.name);
        }
    }
}
