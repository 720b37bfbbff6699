//! What cannot be predicted is refused with its reason.

use super::*;

fn the_papers() -> Model {
    Model {
        geometry: Geometry::equal(FRAC_PI_4, FRAC_PI_4),
        radius_mm: 200.0,
        camera: Description::facing(FRAC_PI_2, FRAC_PI_4, 446.2, [1100.0, 1100.0, 640.0, 320.0]),
        face: Face::Near,
        readings: Readings::Pixels,
        gravity: -Vector3::z(),
        home: [0.0; 2],
        time_origin_s: 0.0,
        slip_time_s: 0.0,
        joint_slip_time_s: 0.0,
        encoder_period: [0.4, 0.3],
        sensor_slip_time_s: 0.0,
    }
}

/// An effect whose covariate is missing and that is quietly left out, or one at zero that spoils the reading.
#[test]
fn an_effect_without_its_covariate_is_refused() {
    for readings in KINDS {
        let bare = Row {
            covariates: Covariates::NONE,
            ..row([2.3, 0.9])
        };
        let model = Model {
            readings,
            ..the_papers()
        };
        let value = |values: &Values| model.with(values).unwrap().row_value(&bare);
        assert!(value(&[0.0; PARAMETERS]).is_ok());
        for p in [
            BACKLASH.start,
            BACKLASH.start + 1,
            CAMERA_DELAY.start,
            THERMAL_GROWTH.start,
            DRIFT.start,
            SLIP.start + 2,
            JOINT_SLIP.start + 1,
            THERMAL_SHIFT.start,
        ] {
            let mut values = [0.0; PARAMETERS];
            values[p] = 1e-3;
            assert!(
                matches!(value(&values), Err(Error::NotFinite { .. })),
                "{p}"
            );
        }
    }
}

/// A value that is no number, an error that leaves no robot or camera, a sphere seen from behind: blamed on the cause.
#[test]
fn what_cannot_be_predicted_says_why() {
    let model = the_papers();
    for index in 0..PARAMETERS {
        let mut values = [0.0; PARAMETERS];
        values[index] = f64::NAN;
        assert_eq!(model.with(&values).err(), Some(Error::NotFinite { index }));
    }
    let with = |index: usize, value: f64| {
        let mut values = [0.0; PARAMETERS];
        values[index] = value;
        model.with(&values)
    };
    assert!(matches!(with(0, -1.0), Err(Error::InvalidGeometry { .. })));
    assert!(matches!(
        with(2, -200.0),
        Err(Error::InvalidGeometry { .. })
    ));
    assert!(matches!(
        with(FOCAL_LENGTH.start, -1.0),
        Err(Error::InvalidCamera { .. })
    ));
    let behind = with(SENSOR_POSE.start + 5, -1000.0).unwrap();
    let found = behind.row_value(&row([2.3, 0.9]));
    assert!(matches!(found, Err(Error::BehindCamera { .. })));
    let aligned = model
        .with(&[0.0; PARAMETERS])
        .unwrap()
        .row_value(&row([1.0, 1.0]));
    assert_eq!(
        aligned,
        Err(Error::SingularPose(Singularity::ElbowsAligned))
    );
    let none = Model {
        gravity: Vector3::zeros(),
        ..model
    };
    assert!(matches!(
        none.with(&[0.0; PARAMETERS]),
        Err(Error::InvalidGeometry { .. })
    ));
    // a reading past the sphere
    let chain = model.with(&[0.0; PARAMETERS]).unwrap();
    let past = chain.inverse_residual(&row([2.3, 0.9]), &Vector2::new(2500.0, 320.0));
    assert!(matches!(past, Err(Error::RayMisses { .. })));
}

/// A residual a whole turn off where joints and azimuths count from different turns.
#[test]
fn the_papers_residual_knows_no_turns() {
    let chain = the_papers().with(&[0.0; PARAMETERS]).unwrap();
    let here = Row {
        push: Vector3::zeros(),
        ..row([2.3, 0.9])
    };
    let reading = chain.row_value(&here).unwrap();
    let turned = Row {
        joints: [2.3 + std::f64::consts::TAU, 0.9 + std::f64::consts::TAU],
        ..here
    };
    let left = chain.inverse_residual(&turned, &reading).unwrap();
    assert!(left.value.amax() < 1e-9, "{}", left.value);
}
