//! Each option in closed loop, beside the same law without it: a few seeded runs each, and bounds well inside of what they came to. Rates with intervals
//! are the sweeps' business. What an option costs where nothing calls for it is in the grid; holes have a file of their own.

use std::io::Cursor;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use domvs::experiment::named;
use domvs::experiment::plan::Overrides;
use image::{ExtendedColorType, ImageEncoder as _, codecs::png::PngEncoder};

use super::lab::{Group, group, pair, sweep, sweep_of};

fn all(group: &Group) -> bool {
    group.successes == group.runs
}

#[test]
fn light_columns_bring_a_camera_home_under_another_light_and_the_plain_law_ends_elsewhere() {
    let text = r#"
        name = "light"
        images = 40
        seed = 32000
        displacements = 3
        tolerance = { error_mm = 2.0, error_deg = 0.1 }   # where light is clipped at white it is no longer of the columns' form
        methods = ["default", { name = "light", settings = { light = {} } }]
        scenes = ["object", "plane", "boxes"]
        [[disturbances]]
        name = "gain and offset"
        disturbance = { light = [{ gain = 0.6, offset = 0.1 }] }
        [[disturbances]]
        name = "slope"
        disturbance = { light = [{ slope = [0.7, 1.2] }] }
    "#;
    let outcomes = sweep(text);
    for disturbance in ["gain and offset", "slope"] {
        let [plain, light] = ["default", "light"]
            .map(|method| group(&outcomes, |run| (&run.disturbance[..], &run.method[..]) == (disturbance, method)));
        assert!(all(&light) && plain.successes == 0, "{disturbance}: {light:?}, without {plain:?}");
    }
}

#[test]
fn without_its_noise_floor_a_noisy_camera_comes_to_rest_nearer() {
    let text = r#"
        name = "noise"
        images = 40
        seed = 32100
        displacements = 3
        methods = ["default", { name = "floor", settings = { noise_floor = "subtract" } }]
        scenes = ["object", "terrain", "boxes"]
        disturbance = { noise_variance = 0.1 }
    "#;
    let [plain, floor] = pair(text, ["default", "floor"]);
    assert!(floor.settled_mm < 0.4 * plain.settled_mm, "{floor:?}, without {plain:?}");
}

#[test]
fn a_constant_depth_that_is_far_off_is_put_right_on_the_way() {
    let text = r#"
        name = "depth"
        seed = 32200
        displacements = 3
        methods = ["default", { name = "estimate", settings = { depth_scale = "estimate" } }]
        scenes = ["object", "plane"]
        [[disturbances]]
        name = "0.4 of the truth"
        disturbance = { depth = { told = "constant", factor = 0.4 } }
        [[disturbances]]
        name = "3 times the truth"
        disturbance = { depth = { told = "constant", factor = 3.0 } }
    "#;
    let [given, estimated] = pair(text, ["default", "estimate"]);
    assert!(all(&estimated) && estimated.images < 0.75 * given.images, "{estimated:?}, given {given:?}");
    assert!(given.successes < given.runs, "{given:?}");
}

/// White, with a black square of this side about the place, pixels; as a PNG in base64.
fn mask(size: u32, [u, v]: [f64; 2], side: f64) -> String {
    let is_hidden = |i: u32| {
        let far = |at: u32, middle: f64| (f64::from(at) + 0.5 - middle).abs();
        far(i % size, u).max(far(i / size, v)) < side / 2.0
    };
    let gray: Vec<u8> = (0..size * size).map(|i| if is_hidden(i) { 0 } else { 255 }).collect();
    let mut png = Cursor::new(Vec::new());
    PngEncoder::new(&mut png).write_image(&gray, size, size, ExtendedColorType::L8).unwrap();
    STANDARD.encode(png.into_inner())
}

#[test]
fn a_mask_over_what_stands_before_the_camera_brings_it_home() {
    // The occluder's side is the root of 0.08 of 128x128, 36.2 pixels; its soft border takes one more on each side.
    let text = format!(
        r#"
        name = "mask"
        images = 40
        seed = 32700
        displacements = 3
        methods = ["default", {{ name = "mask", settings = {{ preprocess = {{ mask = {{ png_base64 = "{}" }} }} }} }}]
        scenes = ["object", "plane", "boxes"]
        disturbance = {{ occluders = [{{ share = 0.08, center = [0.7, 0.35] }}] }}
        "#,
        mask(128, [0.7 * 128.0, 0.35 * 128.0], 38.2)
    );
    let [plain, masked] = pair(&text, ["default", "mask"]);
    assert!(all(&masked) && plain.successes == 0, "{masked:?}, without {plain:?}");
}

#[test]
fn a_step_cap_holds_a_law_that_believes_too_large_a_depth_and_straightens_long_ways() {
    let text = |more: &str| {
        let methods = r#"methods = ["default", { name = "no cap", settings = { step_cap = "none" } }]"#;
        format!("name = 'cap'\nseed = 32400\ndisplacements = 4\n{methods}\n{more}")
    };
    let wild = text("scenes = ['plane']\ndisturbance = { depth = { told = 'constant', factor = 3.0 } }");
    let [capped, free] = pair(&wild, ["default", "no cap"]);
    assert!(all(&capped) && free.successes == 0, "{capped:?}, without {free:?}");
    let full = "[settings]\ngain = { step_fraction = 1.0 }\n[start.random]\nscale = 1.3\n[scene]\nnamed = 'plane'";
    let [capped, free] = pair(&text(full), ["default", "no cap"]);
    assert!(all(&capped) && capped.path_ratio < 0.85 * free.path_ratio, "{capped:?}, without {free:?}");
}

#[test]
fn an_adaptive_gain_begins_as_gently_as_a_low_one_and_arrives_in_half_the_images() {
    let text = r#"
        name = "gain"
        seed = 32500
        displacements = 3
        scenes = ["object", "plane"]
        [[methods]]
        name = "low"
        settings = { gain = { per_s = 2.25 } }
        [[methods]]
        name = "high"
        settings = { gain = { per_s = 12.0 } }
        [[methods]]
        name = "adaptive"
        settings = { gain = { adaptive = { at_zero = 12.0, at_infinity = 2.25, slope_at_zero = 120.0 } } }
    "#;
    let outcomes = sweep(text);
    let [low, high, adaptive] = ["low", "high", "adaptive"].map(|method| group(&outcomes, |run| run.method == method));
    println!("{low:?}\n{high:?}\n{adaptive:?}");
    assert!(all(&low) && all(&high) && all(&adaptive), "{low:?}, {high:?}, {adaptive:?}");
    assert!(adaptive.images < 0.5 * low.images, "{adaptive:?}, low {low:?}");
    assert!(adaptive.path_ratio < 1.05 * low.path_ratio && adaptive.path_ratio < high.path_ratio, "{adaptive:?}");
}

#[test]
fn a_camera_that_may_only_translate_goes_straight_home_and_what_may_not_move_stays_wrong() {
    let text = r#"
        name = "degrees of freedom"
        images = 40
        methods = [{ name = "translates", settings = { degrees_of_freedom = [true, true, true, false, false, false] } }]
        [[scenes]]
        name = "not turned"
        scene = { named = "boxes" }
        start = { displacement = [0.15, -0.1, -0.2, 0, 0, 0] }
        [[scenes]]
        name = "turned"
        scene = { named = "boxes" }
        start = { displacement = [0.15, -0.1, -0.2, 0, 0, 3] }
    "#;
    let outcomes = sweep(text);
    assert!(outcomes[0].converged && outcomes[0].error_deg < 1e-9, "{:?}", outcomes[0]);
    assert!(outcomes[0].path_ratio.is_some_and(|ratio| ratio < 1.1), "{:?}", outcomes[0]);
    assert!(!outcomes[1].converged && (outcomes[1].error_deg - 3.0).abs() < 1e-9, "{:?}", outcomes[1]);
}

/// The sweep `options` of the hard sets, with two starts of each where the experiment has 25: all that counts can say is that nothing breaks.
#[test]
fn an_option_that_nothing_calls_for_costs_at_most_one_of_ten_hard_starts() {
    let methods = ["default", "default + light", "default + noise floor", "default, no cap"];
    let two =
        Overrides { displacements: Some(2), methods: methods.map(str::to_owned).to_vec(), ..Overrides::default() };
    let outcomes = sweep_of(&named::find("options").unwrap(), &two);
    let [plain, others @ ..] = methods.map(|method| group(&outcomes, |run| run.method == method));
    for (method, with) in methods[1..].iter().zip(others) {
        println!("{method}: {with:?}");
        assert!(with.runs == 10 && with.successes + 1 >= plain.successes, "{method}: {with:?}, without {plain:?}");
    }
    assert!(plain.successes >= 9, "{plain:?}");
}
