# SPDX-License-Identifier: Apache-2.0
"""The one description of what motord publishes: `motord.bus.messages.description` reads it, and
dictionaries, JSON, CDR, type hashes, schemas and docs/messages.md are made from it.

`=== TOPIC TYPE` begins a topic. Its lines, in their order:

    let NAMES = EXPRESSION         a value that several fields need
    needs EXPRESSION               where it is false there is no message
    joints EXPRESSION              names and joints that the message is about; all, unless given
    FIELD = EXPRESSION  # UNIT     a field of the type; what is not named is zero or empty
    TYPE FIELD = EXPRESSION  # …   the same, and the type is our own: these lines define it

An expression is Python's. It may use `view` (motord.bus.messages.topics.View), `now` (its
snapshot), `body` (names of frames and joints), `names`, and what `motord.bus.messages.sources`
defines. One that mentions `joint` is a list with one value for each joint. A stamp is a moment of
CLOCK_MONOTONIC in nanoseconds; the message has it as wall time.

Frames: REP 105. Units: REP 103. NaN is what was not measured, as sensor_msgs has it.
"""

TREE = """
=== odom nav_msgs/msg/Odometry
needs now.odometry_stamp_ns
needs isfinite(now.x_m) and isfinite(now.y_m) and isfinite(now.heading_rad)
needs isfinite(now.linear_m_s) and isfinite(now.angular_rad_s)
let xx, xy, xh, yy, yh, hh = now.pose_covariance
let vv, vw, ww = now.twist_covariance
let vs, ss, sw = now.lateral_covariance
header.stamp = now.odometry_stamp_ns  # of the newest feedback in the pose
header.frame_id = body.odom_frame
child_frame_id = body.base_frame
pose.pose.position.x = now.x_m  # m
pose.pose.position.y = now.y_m  # m
pose.pose.orientation.z = sin(now.heading_rad / 2.0)
pose.pose.orientation.w = cos(now.heading_rad / 2.0)
pose.covariance = [
    xx, xy, 0.0, 0.0, 0.0, xh,
    xy, yy, 0.0, 0.0, 0.0, yh,
    0.0, 0.0, UNMEASURED, 0.0, 0.0, 0.0,
    0.0, 0.0, 0.0, UNMEASURED, 0.0, 0.0,
    0.0, 0.0, 0.0, 0.0, UNMEASURED, 0.0,
    xh, yh, 0.0, 0.0, 0.0, hh,
]  # m², m·rad, rad²; x, y, z, about x, about y, about z
twist.twist.linear.x = now.linear_m_s  # m/s
twist.twist.linear.y = now.lateral_m_s  # m/s
twist.twist.angular.z = now.angular_rad_s  # rad/s
twist.covariance = [
    vv, vs, 0.0, 0.0, 0.0, vw,
    vs, ss or vv, 0.0, 0.0, 0.0, sw,
    0.0, 0.0, UNMEASURED, 0.0, 0.0, 0.0,
    0.0, 0.0, 0.0, UNMEASURED, 0.0, 0.0,
    0.0, 0.0, 0.0, 0.0, UNMEASURED, 0.0,
    vw, sw, 0.0, 0.0, 0.0, ww,
]  # m²/s², m·rad/s², rad²/s²; without sideways motion as for x

=== tf tf2_msgs/msg/TFMessage
needs now.odometry_stamp_ns
needs isfinite(now.x_m) and isfinite(now.y_m) and isfinite(now.heading_rad)
transforms[0].header.stamp = now.odometry_stamp_ns
transforms[0].header.frame_id = body.odom_frame
transforms[0].child_frame_id = body.base_frame
transforms[0].transform.translation.x = now.x_m  # m
transforms[0].transform.translation.y = now.y_m  # m
transforms[0].transform.rotation.z = sin(now.heading_rad / 2.0)
transforms[0].transform.rotation.w = cos(now.heading_rad / 2.0)

=== joint_states sensor_msgs/msg/JointState
joints with_position(now, body)
needs names
header.stamp = newest_ns(now, joints)  # of the newest feedback among the joints
name = names
position = joint.position_rad  # rad
velocity = joint.velocity_rad_s  # rad/s

=== imu sensor_msgs/msg/Imu
let imu = now.imu
needs imu is not None and imu.state not in NOT_PUBLISHED and isfinite(imu.angular_rad_s[2])
let x_rad_s, y_rad_s, z_rad_s = imu.angular_rad_s
let x_m_s2, y_m_s2, z_m_s2 = imu.acceleration_m_s2
let accelerates = isfinite(x_m_s2) and isfinite(y_m_s2) and isfinite(z_m_s2)
header.stamp = imu.stamp_ns
header.frame_id = body.base_frame
orientation.w = 1.0
orientation_covariance = NOT_MEASURED
angular_velocity.x = or_zero(x_rad_s)  # rad/s
angular_velocity.y = or_zero(y_rad_s)  # rad/s
angular_velocity.z = z_rad_s  # rad/s
angular_velocity_covariance = [
    tilt_variance(x_rad_s, imu), 0.0, 0.0,
    0.0, tilt_variance(y_rad_s, imu), 0.0,
    0.0, 0.0, yaw_variance(imu),
]  # rad²/s²; about x and y with the zero that is not taken away; zeros: the error is not known
linear_acceleration.x = x_m_s2 if accelerates else 0.0  # m/s²
linear_acceleration.y = y_m_s2 if accelerates else 0.0  # m/s²
linear_acceleration.z = z_m_s2 if accelerates else 0.0  # m/s²
linear_acceleration_covariance = ERROR_UNKNOWN if accelerates else NOT_MEASURED

=== battery_state sensor_msgs/msg/BatteryState
let battery = battery_of(view)
needs battery is not None
header.stamp = battery.stamp_ns  # of the measurement; by drives: of the newest one
voltage = battery.voltage_v  # V
temperature = battery.temperature_c  # °C
current = battery.current_a  # A, into the battery
charge = nan  # Ah
capacity = nan  # Ah
design_capacity = battery.capacity_ah  # Ah
percentage = nan  # 0 to 1
power_supply_status = power_supply_status(battery.current_a)  # 0 unknown, 1 charging, 2 discharging
present = True
cell_voltage = (nan,) * battery.cells  # V

=== diagnostics diagnostic_msgs/msg/DiagnosticArray
header.stamp = now.stamp_ns
status = diagnostics(view, body)

=== motor_status motord_msgs/msg/MotorStatus
let commander = view.commander() or NOBODY
let rest = rest_report(now, body.joints)
std_msgs/Header header
header.stamp = now.stamp_ns
header.frame_id = body.base_frame
string state = state_name(now)  # of the state machine
bool armed = now.armed
bool at_rest = now.at_rest
string rest = now.rest  # at_rest, turning or unknown
string[] rest_unknown = tuple(rest["rest_unknown_s"])  # joints of which it is unknown
float64[] rest_unknown_s = tuple(rest["rest_unknown_s"].values())  # s; for so long
string[] rest_unmeasured = rest["rest_unmeasured"]  # joints that nothing measures
string[] faults = now.faults  # latched
string[] why = view.why()  # what led to the faults
string[] reasons = now.reasons  # why the set-point differs from the request
string commander = commander.owner  # holder of the lease in command; empty: none
int32 commander_priority = commander.priority
string commander_why = commander.why  # why that one is in command
float64 command_age_s = now.command_age_s  # s; infinity: no command ever
float64 setpoint_linear_m_s = now.setpoint_linear_m_s  # m/s
float64 setpoint_angular_rad_s = now.setpoint_angular_rad_s  # rad/s
float64 setpoint_lateral_m_s = now.setpoint_lateral_m_s  # m/s; positive to the left
float64 slip_m_s = now.slip_m_s  # m/s; of the rims against each other
string[] name = names
float64[] setpoint_rad_s = joint.setpoint_rad_s  # rad/s
float64[] duty = joint.duty  # -1 to 1
float64[] current_a = joint.current_a  # A
float64[] voltage_v = joint.voltage_v  # V
float64[] temperature_c = joint.temperature_c  # °C
float64[] feedback_age_s = joint.feedback_age_s  # s; infinity: never received
uint32[] drive_faults = joint.drive_faults  # bits of the drive's fault register
bool[] stale = joint.stale  # the newest feedback is too old

=== loop_statistics motord_msgs/msg/LoopStatistics
let loop = view.loop()
needs loop is not None
let lateness_us, step_ns = loop["lateness_us"], loop["step_ns"]
std_msgs/Header header
header.stamp = view.status_ns
float64 rate_hz = loop["rate_hz"]  # Hz
string policy = loop["policy"]  # of the scheduler
uint64 ticks = loop["ticks"]  # since the loop's start
uint64 overruns = loop["overruns"]  # ticks that began after the next one was due
uint64 page_faults = loop["page_faults"]
float64 lateness_p50_us = lateness_us["p50"]  # µs
float64 lateness_p99_us = lateness_us["p99"]  # µs
float64 lateness_p99_9_us = lateness_us["p99_9"]  # µs
float64 lateness_max_us = lateness_us["max"]  # µs
float64 step_p50_ns = step_ns["p50"]  # ns
float64 step_p99_ns = step_ns["p99"]  # ns
float64 step_p99_9_ns = step_ns["p99_9"]  # ns
float64 step_max_ns = step_ns["max"]  # ns
"""
