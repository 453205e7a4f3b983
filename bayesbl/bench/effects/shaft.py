"""Shaft and tooth flanks; e is the compression beyond the gap.

A rigid bench has neither, so these effects have no law there except hysteresis, which shows as
twist between motor and load.
"""

from __future__ import annotations

from bayesbl.bench.effect_declaration import Effect, amplitude, shape

STIFFNESS_HARDENING = Effect(
    place=150,
    name="stiffness_hardening",
    sentence="The shaft stiffens as it is wound up.",
    equation="τ_s + k₃ e³, e the compression beyond the gap",
    parameters=(amplitude("stiffness_nm_per_rad3", "k₃", low=-1e9, high=1e10, typical=1e9),),
    enters="shaft",
    depends_on=("twist",),
    data="ringing faster under high load torque than under low",
    reference="Tuttle & Seering 1996, IEEE Trans. Robot. Autom. 12, 368",
    always_in=True,
)

# As for curved surfaces of steel: the flank's torque is proportional to e^(1+m). m is 0.11 for a
# line contact (roller bearings, teeth) and 0.5 for a point contact (ball bearings), and less in
# series with shafts. K_s is the stiffness at the largest torque of gravity, or at e₀ = 1 mrad on an
# axis without gravity.
CONTACT_EXPONENT = Effect(
    place=152,
    name="contact_exponent",
    sentence="The contact stiffens with its load (Hertz).",
    equation="τ_s + K_s e [(|e|/e₀)^m − 1], e the compression beyond the gap, e₀ = m g l/K_s",
    parameters=(
        amplitude(
            "excess",
            "exponent of the flanks' torque over compression, less 1, m",
            low=-0.3,
            high=0.6,
            typical=0.05,
            smaller_than=1.0,
        ),
    ),
    enters="shaft",
    depends_on=("twist",),
    data="ringing faster under high load torque than under low, most where the teeth barely touch",
    reference="Palmgren 1959, Ball and Roller Bearing Engineering; Hertz 1882",
)

# Teeth meet one after another, and flanks are not smooth. Contact begins earlier and softer. Far
# from the edge nothing changes, so δ stays where the extrapolated straight flank has zero torque.
# The damper acts in proportion to the mean contact.
CONTACT_SOFTNESS = Effect(
    place=153,
    name="contact_softness",
    sentence="The edges of the gap are soft.",
    equation="K_s max(0, |Δθ| − δ) → its mean over a logistic δ of variance v",
    parameters=(amplitude("variance_rad2", "variance of the edge v", high=1e-7, typical=1e-9),),
    enters="shaft",
    depends_on=("twist",),
    data="impacts that begin softly, most beside a small gap",
    reference="Kahraman & Singh 1991, J. Sound Vib. 146, 135",
    always_in=True,
)

# Teeth that have just met damp nothing yet, whereas the shaft's D_s acts at once.
CONTACT_DAMPING = Effect(
    place=157,
    name="contact_damping",
    sentence="The contact damps more, the more it is compressed (Hunt and Crossley).",
    equation="τ_s + λ K_s |e| ė, e the compression beyond the gap",
    parameters=(
        amplitude(
            "factor_s_per_rad", "damping over stiffness and compression λ", high=5.0, typical=0.5
        ),
    ),
    enters="shaft",
    depends_on=("twist",),
    data="ringing that dies sooner under high load torque than under low",
    reference="Hunt & Crossley 1975, J. Appl. Mech. 42, 440",
    always_in=True,
)

# The damper D_s, parallel to the spring, pulls on parting teeth until the spring is slack. A dry
# flank cannot pull: it releases slightly earlier, where both balance.
CONTACT_RELEASE = Effect(
    place=154,
    name="contact_release",
    sentence="Teeth that part do not pull on one another.",
    equation="(1 − s) τ_s wherever τ_s pulls the flanks together",
    parameters=(
        amplitude("share", "part of the pull that is not there s", high=1.0, typical=0.58),
    ),
    enters="shaft",
    depends_on=("twist",),
    data="the load sets out across the gap a little sooner, and meets the other flank more gently",
    reference="Hunt & Crossley 1975, J. Appl. Mech. 42, 440",
    always_in=True,
)

# A film of lubricant between the flanks, or a damper beside the gear, acts where no teeth touch.
GAP_DAMPING = Effect(
    place=158,
    name="gap_damping",
    sentence="The lubricant in the gear damps motion within the gap too.",
    equation="τ_s = d Δω where no teeth touch",
    parameters=(
        amplitude(
            "coefficient_nm_s_per_rad",
            "damping torque over twist speed d",
            high=1000.0,
            typical=10.0,
        ),
    ),
    enters="shaft",
    depends_on=("twist",),
    data="teeth that meet later and more softly than gravity and friction alone let them",
    reference="Nordin & Gutman 2002, Automatica 38, 1633",
    always_in=True,
)

# For asymmetric or unevenly worn teeth: stiffer by the share a where the shaft drives the load
# forward, and softer by the same share where it drives it backward.
FLANK_ASYMMETRY = Effect(
    place=155,
    name="flank_asymmetry",
    sentence="The two tooth flanks differ in stiffness.",
    equation="τ_s + a K_s |e|, e the compression beyond the gap",
    parameters=(
        amplitude(
            "share",
            "half the difference of the two stiffnesses over their mean a",
            low=-0.6,
            high=0.6,
            typical=0.05,
            smaller_than=1.0,
        ),
    ),
    enters="shaft",
    depends_on=("twist",),
    data="ringing on one flank faster than on the other",
    reference="Kapelevich 2000, Mechanism and Machine Theory 35, 117",
)


SHAFT_HYSTERESIS = Effect(
    place=160,
    name="shaft_hysteresis",
    sentence=(
        "Dry friction inside the shaft (Dahl): torque that depends on the path of the twist."
    ),
    equation="τ_s + T z, dz/dt = (Δω/θ_p)(1 − z sign Δω), also inside the gap",
    parameters=(
        amplitude("torque_nm", "friction torque T", high=200.0, typical=20.0),
        shape(
            "angle_rad",
            "twist that builds it up θ_p",
            low=1e-5,
            high=1e-2,
            neutral=1e-3,
            typical=1e-3,
        ),
    ),
    enters="shaft",
    depends_on=("twist", "direction"),
    data="ringing that dies sooner; the gap is crossed more slowly",
    reference=(
        "Dahl 1976, AIAA Journal 14, 1675; Ruderman, Bertram & Iwasaki 2014, Mechatronics 24, 407"
    ),
)
