"""Faults that may befall the arm: each a system in the diagram, one file each, with a severity from 0 to 1.

Knows arrays, pictures and Drake; what knows cans is in diagrams/world/faults/, as is the registry of all.

======================  ============================================================================================
fault                   what every fault shares: severity, onset, duration, chance by seed and counter
picture_fault           what the faults of the camera share
camera_gain             the light changes
camera_colour           the light changes its colour
camera_shadow           a shadow falls on a part of the scene
camera_blur             out of focus
camera_noise            noisy pixels
camera_occlusion        something is held before the camera
camera_frozen           the picture stands still (abstract state)
camera_dropped          frames are lost: black
camera_shift            the camera was turned a little
camera_latency          the picture comes late (abstract state)
posture_fault           what the faults of the joints' sensors share
joint_offset            one joint is read wrong by a constant
joint_noise             noisy joint angles
joint_stuck             one joint's reading sticks (discrete state)
servo_fault             what the faults of the servo share: a softer one, by the command that has its effect
weak_servo              one joint's servo gets weak
slack_gripper           the fingers let go
late_step               the controller's step comes too late: the last command holds (discrete state)
payload                 a weight at the hand
push                    what the pushes share: a force, and a soft servo
push_hand               a person pushes the hand
push_elbow              a person pushes the elbow
repeated_disturbance    what those share that come more than once (discrete state)
disturbed_return        moved away, and again on the way home
disturbed_resumption    moved away, and again as soon as the network has the arm again
disturbed_thrice        moved away three times
======================  ============================================================================================
"""
