"""What runs: one Drake LeafSystem a file, and the Diagrams that wire them.

Knows arrays and Drake, and what `models/` offers; knows nothing of cans, desks and shelves (that is `diagrams/`).
Every constructor argument is a physical quantity; everything that a system remembers is in its Context.

=====================  =============================================================================================
image_encoder          image -> features
recurrent_policy       network input -> predicted posture and features, recalled postures (discrete state)
home_reset             when the network starts anew: the arm is at home, and what it imagines is not
finger_release         fingers that hold nothing open where the network starts anew
posture_history        posture -> the posture now and those of the last N + 1 ticks (discrete state)
loop_closer            Eqs. 7 and 8: what the network is fed
detectors              the one list of the detectors
detector               what a detector is, and what ours share: Eqs. 5 and 6, its calibration in the Context
recall_detector        the paper's, Eq. 4: recalled against measured postures; and the picture beside them
window_detector        what the two baselines have in common: the last samples of each joint
knn_detector           the first baseline: distance to the nearest training window
subspace_detector      the second: what is outside the leading axes of the training windows
innovation_detector    does what the network predicted, posture and features, come true?
cusum_detector         the cumulative sum of these errors (discrete state)
vector_detector        what detectors have in common that judge the hidden state, or it and the features
mahalanobis_detector   distance of the hidden state to those of normal runs, in their spread
clusters_detector      PCA and k-means: distance to the nearest cluster
distillation_detector  random network distillation
flow_detector          logpZO: the noise that a flow leads back to
pyod_detector          any of PyOD's, by its name
ensemble_detector      do networks of other training seeds predict the same? (discrete state)
reversals_detector     how much the arm turns back on itself
speed_detector         how fast it is
never_detector         none: the network alone
oracle_detector        told of the fault: what could be reached (discrete state)
posture_regulator      Drake's LQR for the discrete posture integrator
alarm_backoff          an alarm that comes again: what the next one must reach (discrete state)
alpha_mixer            Eq. 3: the RNN's step and the LQR's, mixed and clamped
regulated_mixer        the two of them, as one Diagram
clearance_filter       the way home that looks: the smallest change of a step that keeps the arm at a distance
acceleration_limit     the way home speeds up evenly (discrete state)
incremental_command    the way home adds to the last command, not to the measured posture (discrete state)
disturbance            moves or stops the arm in an experiment (discrete state)
manual_disturbance     a person's hand on the arm: holds or moves it, whenever a signal says so (discrete state)
signal_schedule        a signal that changes at given ticks: what a person did, when
body_force             a force that pulls at a body
camera_fault           the camera is covered, it gets dark, its picture freezes (abstract state)
first_given            two sources for one signal, by rank
dialled_detector       a detector whose gamma is an input
signal_logic           requirements in signal temporal logic: by how much arrays of signals keep them
signal_logic_text      their text, read
signal_logic_online    their values tick by tick, in memory that does not grow
requirement_monitor    watches them while the diagram runs (discrete state)
switched_controller    all of the controller, as one Diagram
arguments              checks of constructor arguments
=====================  =============================================================================================

Faults, which diagrams/FAULTS.md lists, are in the room faults/; what the arm does after an alarm, in recoveries/.
"""
