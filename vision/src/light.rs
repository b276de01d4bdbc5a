//! A light that changes: `I = I* + g I* + o + (g_u u + g_v v) I* + o_u u + o_v v`, besides what motion does.
//!
//! The columns `C` are features of the six planes `{I*, 1, u I*, v I*, u, v}`, with `u` and `v` from -1 to 1 across the image.

use crate::image::Plane;
use crate::sample::Sample;

/// Row `v` of the planes `{I*, 1, u I*, v I*, u, v}`, in this order.
pub(crate) fn light_row<T: Sample>(desired: &Plane<T>, v: usize, planes: [&mut [T]; 6]) {
    let [width, height] = desired.size();
    let down = T::from_f64(across(v, height));
    let [own, one, u_own, v_own, u_plane, v_plane] = planes;
    for (u, sample) in desired.row(v).iter().enumerate() {
        let right = T::from_f64(across(u, width));
        (own[u], one[u]) = (*sample, T::from_f64(1.0));
        (u_own[u], v_own[u]) = (right * *sample, down * *sample);
        (u_plane[u], v_plane[u]) = (right, down);
    }
}

/// Where pixel `i` of `length` lies between -1 and 1.
pub(crate) fn across(i: usize, length: usize) -> f64 {
    2.0 * i as f64 / (length - 1) as f64 - 1.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_planes_are_the_desired_image_and_one_each_also_sloped_from_border_to_border() {
        let desired = Plane::from_fn(5, 3, |u, v| (1 + u + 10 * v) as f64);
        let mut planes = [[0.0; 5]; 6];
        light_row(&desired, 2, planes.each_mut().map(|plane| &mut plane[..]));
        assert_eq!(planes[0], [21.0, 22.0, 23.0, 24.0, 25.0]);
        assert_eq!((planes[1], planes[2]), ([1.0; 5], [-21.0, -11.0, 0.0, 12.0, 25.0]));
        assert_eq!((planes[3], planes[4], planes[5]), (planes[0], [-1.0, -0.5, 0.0, 0.5, 1.0], [1.0; 5]));
    }
}
