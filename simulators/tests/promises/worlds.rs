//! Worlds as they are written: every named one is a world, and what is wrong is said with its numbers.

use std::path::Path;

use domvs_simulators::spec::{RandomStart, StartSpec, WorldSpec, named_worlds};
use domvs_simulators::{PinholeCamera, World, motion};
use domvs_vision::Plane;
use nalgebra::{Isometry3, Point3};

fn named(name: &str) -> World {
    WorldSpec::named(name).and_then(|spec| spec.build(Path::new("."))).expect(name)
}

fn deviation(gray: &Plane<f32>) -> f32 {
    let count = gray.samples().len() as f32;
    let mean = gray.samples().iter().sum::<f32>() / count;
    (gray.samples().iter().map(|s| (s - mean).powi(2)).sum::<f32>() / count).sqrt()
}

#[test]
fn every_named_world_has_contrast_and_depth_at_its_target_and_at_its_starts() {
    for name in named_worlds() {
        let world = named(name);
        assert_eq!(world.name, name);
        let small = PinholeCamera::with_field_of_view(64, 64, 60.0_f64.to_radians()).expect("possible");
        for pose in [world.desired, world.start_pose(0), world.start_pose(1)] {
            let rendering = world.scene.render(&small, &pose);
            assert!(deviation(&rendering.image) > 0.05, "{name} is flat: {}", deviation(&rendering.image));
            assert!(rendering.image.samples().iter().all(|gray| (0.0..=1.0).contains(gray)), "{name} is not gray");
            let known = rendering.true_depth.samples().iter().filter(|&&z| z > 0.0).count();
            assert!(known > 64 * 64 / 2, "{name} has depth at {known} of {} pixels", 64 * 64);
        }
    }
}

#[test]
fn a_world_is_its_toml() {
    for name in named_worlds() {
        let spec = WorldSpec::named(name).expect(name);
        assert_eq!(WorldSpec::from_toml(&spec.to_toml()).expect("what was written"), spec, "{name}");
    }
    let empty = WorldSpec::from_toml("").expect("everything has a default");
    assert_eq!(empty, WorldSpec::default());
}

#[test]
fn what_is_wrong_is_said_with_its_numbers() {
    let cases = [
        ("seeed = 3", "seeed"),
        ("[camera]\nwidth = 4", "camera.width: expected 8 to 4096, got 4"),
        ("[camera]\nhorizontal_fov_deg = nan", "got NaN"),
        ("[scene]\nnamed = \"mona_lisa\"", "mona_lisa"),
        ("[scene]\nnamed = \"boxes\"\nposition_m = [0, 0, 1]", "scene.named"),
        ("[[scene.objects]]\nsize_m = [1.0]\ngray = 0.5", "1 of a Plane"),
        ("[[scene.objects]]\nsize_m = [1.0, -2.0]\ngray = 0.5", "got -2"),
        ("[[scene.objects]]\nsize_m = [1.0, 1.0]", "texture or gray"),
        ("[[scene.objects]]\nsize_m = [1.0, 1.0]\ntexture = \"no.png\"", "no.png"),
        ("[scene.background]\nphotograph = \"coffee\"", "distance_m"),
        ("[target]\nlook_at_m = [0, 0, 1]", "target"),
        ("[start]\nrandom = {}\ndisplacement = [0, 0, 0, 0, 0, 0]", "start"),
        ("[start.random]\ntranslation_m = [[1, 0], [0, 0], [0, 0]]", "[1.0, 0.0]"),
        ("[disturbance]\nnoise_variance = -0.1", "got -0.1"),
        ("[disturbance.depth]\nholes = 1.5", "got 1.5"),
        ("[[disturbance.light]]\nslope = [0.7, 12.0]", "got 12"),
    ];
    for (toml, expected) in cases {
        let world = WorldSpec::from_toml(toml).and_then(|spec| spec.build(Path::new(".")));
        let error = world.map(|world| world.name).expect_err(toml).to_string();
        assert!(error.contains(expected), "{toml:?}: {error:?} does not say {expected:?}");
    }
}

#[test]
fn random_starts_are_a_function_of_seed_and_number_and_within_their_ranges() {
    let random = RandomStart { scale: 1.5, ..RandomStart::default() };
    let start = StartSpec::random(random);
    let middle = Point3::new(0.1, -0.05, 1.0);
    let pose = |seed, number| start.pose(&Isometry3::identity(), &middle, seed, number);
    assert_eq!(pose(3, 14), pose(3, 14));
    assert_ne!(pose(3, 14), pose(3, 15));
    assert_ne!(pose(3, 14), pose(4, 14));
    let ranges = [[-0.5, 0.5], [-0.4, 0.4], [-0.4, 0.1]];
    let (mut widest, mut largest_roll) = (0.0_f64, 0.0_f64);
    for number in 0..500 {
        let pose = pose(7, number);
        for (axis, [least, most]) in ranges.into_iter().enumerate() {
            let along = pose.translation.vector[axis];
            assert!((1.5 * least..=1.5 * most).contains(&along), "start {number} of seed 7: {along} m");
        }
        let axis = pose.rotation * nalgebra::Vector3::z();
        let on_disc = pose.translation.vector + axis * ((middle.z - pose.translation.z) / axis.z);
        let off_m = (on_disc - middle.coords).norm();
        widest = widest.max(off_m);
        // f64 rounding of a turn and a division.
        assert!(off_m <= 0.15 + 1e-12, "start {number} of seed 7 looks {off_m} m beside the middle");
        let level = nalgebra::UnitQuaternion::rotation_between(&nalgebra::Vector3::z(), &axis).expect("not behind");
        largest_roll = largest_roll.max((level.inverse() * pose.rotation).angle().to_degrees());
    }
    assert!(widest > 0.14, "500 starts come near the border of the disc, {widest} m");
    assert!((33.0..=35.0 + 1e-9).contains(&largest_roll), "500 starts come near the largest roll, {largest_roll} deg");
}

#[test]
fn a_start_is_relative_to_the_target() {
    let toml = "[scene]\nnamed = \"object\"\n[target]\nposition_m = [0.1, 0.0, 0.1]\nlook_at_m = [0.0, 0.1, 1.0]\n\
                [start]\ndisplacement = [0.1, 0.0, -0.2, 0.0, 5.0, 10.0]";
    let world = WorldSpec::from_toml(toml).and_then(|spec| spec.build(Path::new("."))).expect("a world");
    let expected = motion::displacement_to_pose([0.1, 0.0, -0.2, 0.0, 5.0, 10.0]);
    let error = motion::pose_error(&expected, &(world.desired.inverse() * world.start_pose(0)));
    // f64 rounding.
    assert!(error.mm < 1e-9 && error.deg < 1e-9, "{error:?}");
    let looked_at = world.desired.inverse() * Point3::new(0.0, 0.1, 1.0);
    assert!(looked_at.x.abs() < 1e-12 && looked_at.y.abs() < 1e-12 && looked_at.z > 0.0, "{looked_at}");
    // The axis meets the plane at z = 1: that is the middle.
    assert!((world.middle - Point3::new(0.0, 0.1, 1.0)).norm() < 1e-6, "{}", world.middle);
}

#[test]
fn the_documentation_has_every_key_with_its_default() {
    let text = include_str!("../../../docs/worlds.md");
    // A world with something under every key.
    let full = "[scene.background]\nphotograph = \"noise\"\nphotograph_seed = 1\nwidth_m = 1\ndistance_m = 1\n\
                [[scene.objects]]\ntexture = \"noise\"\ntexture_seed = 1\nrepeat = [1, 1]\ngray = 1\nfile = \"a.obj\"\n\
                heights = \"noise\"\nheights_seed = 1\ncells = 48\n\
                [target]\ndisplacement = [0, 0, 0, 0, 0, 0]\nposition_m = [0, 0, 0]\nlook_at_m = [0, 0, 0]\nroll_deg = 0\n\
                [start]\ndisplacement = [0, 0, 0, 0, 0, 0]\nrandom = {}\n\
                [[disturbance.light]]\nslope = [1, 1]\nspot = {}\n[[disturbance.occluders]]";
    let mut spec = WorldSpec::from_toml(full).expect("every key is known");
    spec.scene.named = Some("object".to_owned());
    spec.scene.middle_m = Some([0.0; 3]);
    let table: toml::Table = spec.to_toml().parse().expect("TOML");
    let mut keys = vec![];
    flatten("", &toml::Value::Table(table), &mut keys);
    assert!(keys.len() > 50, "only {} keys", keys.len());
    for (key, default) in keys {
        let row = text.lines().find(|line| line.starts_with(&format!("| `{key}` |")));
        let row = row.unwrap_or_else(|| panic!("docs/worlds.md has no row for `{key}`"));
        let said = row.split('|').nth(2).unwrap_or_default().trim();
        if let Some(said) = said.strip_prefix('`').and_then(|said| said.strip_suffix('`')) {
            let said: toml::Table = format!("value = {said}").parse().expect("a default is TOML");
            let number = |value: &toml::Value| value.as_integer().map(|whole| whole as f64).or(value.as_float());
            let equal =
                said["value"] == default || (number(&default).is_some() && number(&said["value"]) == number(&default));
            assert!(equal, "`{key}` is {default}, and {} in docs/worlds.md", said["value"]);
        }
    }
    for name in named_worlds() {
        assert!(text.contains(&format!("`{name}`")), "docs/worlds.md does not name {name}");
    }
}

/// Dotted keys and their values; of a list of tables, those of its first.
fn flatten(prefix: &str, value: &toml::Value, keys: &mut Vec<(String, toml::Value)>) {
    let inner = match value {
        toml::Value::Table(table) => table,
        toml::Value::Array(list) if list.first().is_some_and(toml::Value::is_table) => {
            return flatten(prefix, &list[0], keys);
        }
        _ => return keys.push((prefix.to_owned(), value.clone())),
    };
    for (key, value) in inner {
        let dotted = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
        flatten(&dotted, value, keys);
    }
}
