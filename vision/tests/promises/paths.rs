//! Every set of instructions this machine has gives the same twist, in `f32` as near to `f64` as rounding allows, on sizes no vector divides.

use domvs_vision::{LightPrior, Path, Sample, Step};

use super::scenes::{Pair, every_method, every_method_on_pixels, relative_difference, with_order};

const SIZES: [(usize, usize); 3] = [(64, 48), (97, 71), (33, 130)];

/// Three steps: both views at once, then the desired half and the current one, then the current one alone.
fn steps<T: Sample>(pair: &Pair<T>, law: domvs_vision::Law, path: Path) -> [Step; 3] {
    let mut servo = pair.servo(law);
    servo.set_path(path);
    [0; 3].map(|_| servo.step(pair.current()).unwrap())
}

fn agree(a: &Step, b: &Step, tolerance: f64, which: &str) {
    let difference = relative_difference(&a.gauss_newton, &b.gauss_newton);
    assert!(difference < tolerance && a.order == b.order && a.window == b.window, "{which}: {difference:e}");
}

#[test]
fn every_path_gives_the_same_twist() {
    let lit = |law: domvs_vision::Law| domvs_vision::Law { light: Some(LightPrior::default()), ..law };
    for ((width, height), is_mapped) in SIZES.into_iter().flat_map(|size| [(size, true), (size, false)]) {
        let (single, double) = match is_mapped {
            true => (Pair::<f32>::at_mapped_depth(width, height), Pair::<f64>::at_mapped_depth(width, height)),
            false => (Pair::<f32>::at_constant_depth(width, height), Pair::<f64>::at_constant_depth(width, height)),
        };
        for law in every_method().into_iter().chain(every_method_on_pixels()).flat_map(|law| [law, lit(law)]) {
            let law = with_order(law, 6);
            let expected = steps(&double, law, Path::best());
            for path in Path::available() {
                let which = format!("{width}x{height}, {path}, {law:?}");
                for (step, expected) in steps(&double, law, path).iter().zip(&expected) {
                    // Rounding, times a condition number of up to 1e6.
                    agree(step, expected, 1e-9, &which);
                }
                for (step, expected) in steps(&single, law, path).iter().zip(&expected) {
                    agree(step, expected, 1e-5, &which);
                }
            }
        }
    }
}
