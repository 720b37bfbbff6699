//! Shapes that are none are refused.

use super::*;

/// Orders or lengths that do not fit and are taken.
#[test]
fn wrong_shapes_are_refused() {
    let zero = [[0.0; 3]; 8];
    let new = |orders, coefficients| Correction::new(orders, domain(), coefficients).err();
    assert_eq!(new([1, 1, 1], &zero), None);
    for found in [0, 7] {
        let expected = 8;
        let refused = new([1, 1, 1], &zero[..found]);
        assert_eq!(refused, Some(Error::WrongLength { expected, found }));
    }
    let (expected, found) = (MAX_ORDER, MAX_ORDER + 1);
    let refused = Some(Error::WrongLength { expected, found });
    assert_eq!(new([found, 0, 0], &zero), refused);
    let points = [0.0, 0.5, 1.0];
    let project = |order, projector, scratch| {
        project_axis(
            order,
            &points,
            &mut vec![0.0; projector],
            &mut vec![0.0; scratch],
        )
    };
    let scratch = axis_scratch_len(3, 1);
    assert_eq!(project(1, 6, scratch), Ok(()));
    assert_eq!(project(found, 30, scratch).err(), refused);
    for (projector, scratch) in [(5, scratch), (6, scratch - 1), (6, scratch + 1)] {
        assert!(matches!(
            project(1, projector, scratch),
            Err(Error::WrongLength { .. })
        ));
    }
}
