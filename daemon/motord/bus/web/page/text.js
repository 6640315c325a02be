// SPDX-License-Identifier: Apache-2.0
// Every string that a person reads, for translators. Texts that the robot sends come as they are.

export const TEXT = {
  tabs: {
    overview: "Overview", drive: "Drive", plots: "Plots", lines: "Lines",
    parameters: "Parameters", file: "Robot file", commission: "Commissioning", log: "Log",
    fleet: "Fleet",
  },
  navigation: "Pages of the dashboard",
  skip: "Skip to the content",
  theme: "Change between light and dark",
  title: (robot, state) => `${state} · ${robot}`,

  connecting: "Connecting",
  connected: "Connected",
  notLoaded: (tab, why) => `${tab} cannot be loaded (${why}). `
    + "Choose it again, or reload the page.",
  lost: "Connection lost",
  stale: "No state",
  lostText: "No connection to the robot. This page tries again. The robot may be moving, and "
    + "E-STOP may not arrive: use the switch on the robot.",
  staleText: "No state comes from the robot. It may be moving, and E-STOP may not arrive: use the "
    + "switch on the robot.",
  noState: "No state comes from the robot.",
  lastState: (state, s) => (Number.isFinite(s) ? `Last state, ${s} s ago: ${state}` : ""),
  notKnown: "not known",
  notKnownSince: (s) => (Number.isFinite(s) ? `not known since ${s.toFixed(1)} s`
    : "not known yet"),
  refusedTitle: "Token needed",
  tokenLabel: "Token of this robot",
  tokenHelp: "It is in the file that token_file names in the robot file.",
  tokenSend: "Connect",
  tokenAgain: "Enter the token to command",
  tokenForget: "Forget the token on this device",
  watching: "You may watch, not command",
  watchOnly: "This dashboard only shows the robot ([publish.web]).",
  rate: (hz, ms) => `${hz} states a second, ${ms} ms for an answer`,

  estop: "E-STOP",
  estopKey: "space bar",
  estopHelp: "Emergency stop: all wheels come to rest and lose power. Key: space bar",
  estopNoToken: "E-stop: needs the token",
  estopUnsure: "may not arrive",
  estopDoubt: (why) => `E-STOP: ${why}. It may not have arrived: use the switch on the robot.`,
  arm: "Arm", disarm: "Disarm", stop: "Stop", reset: "Reset", resetOdometry: "Set pose to zero",
  failed: (what, why) => `${what}: ${why}`,

  states: {
    off: "Off", configuring: "Getting ready", idle: "Ready, no power", armed: "Armed, at rest",
    moving: "Moving", stopping: "Stopping", fault: "Fault", estop: "Emergency stop",
    unknown: "Unknown",
  },
  next: {
    off: "The daemon is starting or ending.",
    configuring: "Wait until all drives answer.",
    idle: "Arm to power the drives.",
    armed: "Drive, or disarm to remove the power.",
    moving: "Stop brings it to rest.",
    stopping: "It comes to rest.",
    fault: "Remove the cause, then reset and arm.",
    estop: "When it is safe, reset and arm.",
    unknown: "No state comes from the robot. It may be moving: keep away from it.",
  },
  restUnknown: (joints) => `motord cannot see whether ${joints.join(" and ") || "a wheel"} `
    + `${joints.length > 1 ? "turn" : "turns"}: keep away, cut the power`,
  because: "Because",
  limited: "Limited by",
  held: (names) => `Held: ${names}. It requested motion when the robot could not move, and moves `
    + "nothing until it sends zero or is started anew. While armed, Arm lets it go on.",
  reasons: {
    linear_velocity: "speed limit", linear_acceleration: "acceleration limit",
    linear_deceleration: "deceleration limit", linear_jerk: "jerk limit",
    angular_velocity: "turn rate limit", angular_acceleration: "turn acceleration limit",
    angular_deceleration: "turn deceleration limit", angular_jerk: "turn jerk limit",
    wheel_saturated: "a wheel at its limit", duty_clamped: "duty at its limit",
    duty_slew: "duty slew rate", stop_requested: "a stop was requested",
    command_stale: "the command is old", command_not_finite: "the command is not a number",
    fault: "a fault", not_armed: "not armed",
  },

  commander: "In command",
  noCommander: "no source",
  drivenBy: (page) => `driven by ${page}`,
  battery: "Battery",
  batteryUnknown: "not measured",
  pages: "Pages open",
  pose: "Pose", speed: "Speed", turn: "Turn rate", distance: "Distance", heading: "Heading",
  setpoint: "Set-point", measured: "Measured", lateral: "Sideways",
  baseView: "The base from above, with wheels, speeds and its trail",
  legend: { speed: "speed", setpoint: "set-point", trail: "trail" },
  zoomIn: "Zoom in", zoomOut: "Zoom out", clearTrail: "Clear the trail",
  joints: "Joints",
  joint: "Joint", drive: "Drive", current: "Current", voltage: "Voltage",
  temperature: "Temperature", position: "Position", age: "Feedback age", duty: "Duty",

  noBase: "This robot has no base to drive. `motord joints` moves its joints.",
  pad: "Drive pad: press its middle and move; release it to stop",
  padHint: "Press the middle, then drag",
  strafe: "Move sideways instead of turning",
  limiter: "Speed limit of this page",
  keys: "Keys: W A S D or arrows drive while they are held, Q and E move sideways",
  gamepad: "Gamepad",
  gamepadNone: "none: connect one and press a button",
  gamepadHint: "Hold the left shoulder button (dead-man) with the left stick in its middle, "
    + "then move the stick.",
  deadMan: "The robot stops when you release, when this page loses the focus or is hidden, "
    + "and when the connection is silent for 0.3 s.",
  armFirst: "Arm the robot first.",
  releasedBy: {
    blur: "Released: the page lost the focus.",
    hidden: "Released: the page was hidden.",
    lost: "Released: the connection is silent.",
    outside: "A drive begins in the middle of the pad.",
    swiped: "Released: rest in the middle of the pad first, then drag.",
    taken: "Released: another key, a menu or a drag could hide your release from this page.",
  },
  requested: "Requested",
  driving: "Driving",
  notDriving: "Not driving",

  pause: "Pause", resume: "Resume", csv: "Export CSV", window: "Time shown",
  seconds: (s) => `${s} s`,
  dropped: (n) => `${n} states not received`,
  plots: {
    velocity: "Wheel speed and set-point", position: "Wheel position", current: "Current",
    voltage: "Voltage", temperature: "Temperature", linear: "Speed of the base",
    angular: "Turn rate of the base", lateness: "Lateness of the loop, last minute",
    trips: "Round trips", errors: "Errors on the lines",
  },
  plotHelp: "Drag to zoom, double-click to show all. Every plot has the same time axis.",
  late: "ticks",
  noData: "Nothing measured",

  line: "Line", port: "Port", engine: "Engine", exchanges: "Exchanges", roundTrip: "Round trip",
  cycle: "Cycle rate",
  ofRequested: (rate, requested) => `${rate} of ${requested} Hz`,
  noErrors: "no errors",
  reopened: (n) => `opened again ${n} times`,
  errorKinds: {
    no_reply: "No reply in time. The request was sent again. "
      + "Look at power, address, wiring and termination.",
    bad_reply: "A reply was damaged or too late and was not used. "
      + "Look at termination, shielding and baud rate.",
    refused: "The drive refused a request. Its manual explains the exception.",
    port: "The port was lost and opened again. Look at the adapter and its cable.",
    sent: "A frame could not be sent.",
    bus_off: "The CAN controller left the CAN bus after too many errors. "
      + "Look at bit rate and termination.",
    other: "See the log for its cause.",
  },
  registers: "Registers",
  register: "Register", value: "Value", unit: "Unit", range: "Range", source: "Source",
  read: "Read", readAll: "Read all", write: "Write",
  writeOnlyDisarmed: "Registers can be written while the robot is disarmed. "
    + "A drive forgets them when it loses power.",

  limits: "Limits",
  apply: "Apply", revert: "Revert", unchanged: "No change",
  changed: (n) => (n === 1 ? "1 change" : `${n} changes`),
  noLimit: "no limit",
  lasting: "Changes count at once and last until the daemon ends. "
    + "Save writes them to the robot file.",
  save: "Save to the robot file…", difference: "What changes in the robot file",
  wouldSave: (file) => `This would change in ${file}. `
    + "Comments stay, and the old file is kept beside it.",
  saved: (file) => `Written: ${file}`,
  nothingToSave: (file) => `${file} already has the limits that are in force.`,
  close: "Close", cancel: "Cancel",
  forceNow: "in force",
  force: "Set it all the same",
  fromFile: (value) => `robot file: ${value}`,
  most: (low, high, unit) =>
    (high === null ? `at least ${low} ${unit}` : `${low} to at most ${high} ${unit}`),

  // The robot file in its editor
  fileNeedsToken: "The robot file is shown to pages that have the token.",
  writingNeedsToken: "Only a page that has shown the token of this robot may write the file.",
  fileHelp: "The daemon uses the file that it read at its start: restart it to use what you save. "
    + "Ctrl and space list keys and values, Esc closes the list, "
    + "Ctrl and S shows what would be saved. A file that does not pass the check is not written.",
  fileChanged: "Changed, not saved",
  completions: "Keys and values",
  aboutKey: "Move the cursor to a key to see what it means.",
  fallback: (value) => `default ${value}`, isFallback: "default",
  check: "Check", checking: "Checking…",
  checked: (problems, warnings) =>
    (problems === 1 ? "1 problem, " : `${problems || "No"} problems, `)
    + (warnings === 1 ? "1 warning" : `${warnings || "no"} warnings`),
  messages: "What the check found",
  atLine: (line) => `Line ${line}`, warning: "Warning:",
  loadAgain: "Load again", takeTheirs: "Discard my changes, load the file",
  keepMine: "Keep my text, compare it with the file now",
  sameFile: (file) => `${file} has this text already.`,
  conflict: "Not saved: another program has changed the file on the robot "
    + "since this page loaded it.",
  notSaved: "Not saved: the check finds problems. They are listed below the text.",

  events: "Events",
  filter: "Filter",
  levels: { all: "All", warning: "Warnings and errors", error: "Errors" },
  noEvents: "No event.",
  recordings: "Recordings",
  download: "Download",
  size: (bytes) =>
    bytes < 1e6 ? `${(bytes / 1e3).toFixed(0)} kB` : `${(bytes / 1e6).toFixed(1)} MB`,

  // Commissioning, and the robot file
  commissionedBy: (procedure, page) =>
    `${TEXT.procedures[procedure]?.title ?? procedure} is running${page ? ` on ${page}` : ""}: `
    + "it commands the robot, so no page can.",
  procedures: {
    spin: {
      title: "First turn of each wheel",
      about: "Turns one wheel at a time, asks what you see, and compares it with the encoders. "
        + "Finds swapped wheels, inverted motors, and encoders that are turned or unplugged. "
        + "The wheels have to be off the ground.",
    },
    straight: {
      title: "Wheel radii",
      about: "Drives forward and back on a line. You measure with a tape where it ends.",
    },
    rotate: {
      title: "Track",
      about: "Turns on the spot to the left and to the right. You measure the angle to a mark.",
    },
    square: {
      title: "Track and ratio of the radii",
      about: "Drives a square in both directions (UMBmark). You measure where it ends.",
    },
    all: {
      title: "Radii and track, all runs",
      about: "The line, the turns and the squares, fitted together; then dead band and "
        + "feed-forward where the drives take a duty.",
    },
    deadband: {
      title: "Dead band",
      about: "For drives that take a duty: short runs at rising speeds. "
        + "Sets the duty below which a wheel does not turn.",
    },
    feedforward: {
      title: "Dead band and feed-forward",
      about: "The same runs; sets the speed at full duty, too.",
    },
    tune: {
      title: "Gains of a wheel",
      about: "For drives that take a duty or a torque: steps forward and back on the floor. "
        + "Finds friction, inertia and dead time of one wheel, computes the gains of its speed "
        + "loop, and drives the same steps with them.",
    },
    gyro: {
      title: "Gyro",
      about: "Turns that end at a mark. Sets the variance of the gyro's heading.",
    },
  },
  procedure: "Procedure", whichWheels: "Wheels", allWheels: "all, one after the other",
  commissionHelp: "motord writes nothing before you have seen the difference and agreed. "
    + "The robot comes to rest and is disarmed when you stop the procedure, "
    + "when this page loses the focus, is hidden, closed or left, and when its connection is "
    + "silent for 1 s. While a question is open the robot rests without power.",
  commissionNeedsToken: "Commissioning needs the token.",
  begin: "Begin", yes: "Yes", no: "No", sendAnswer: "Answer", another: "Another procedure",
  stopProcedure: "STOP", stopKey: "any key",
  questionTitle: "Question",
  preparing: "Preparing",
  goOn: "Continue on this page",
  abandoned: "The page that ran this procedure is gone. The robot rests without power.",
  otherConducts: (page) => `${page} runs this procedure. You can stop it here.`,
  resultGood: "Done", resultBad: "Not done",
  writtenFile: (file) => `${file} is written. The old file is kept beside it.`,
  restart: "Restart the daemon to use the new file.",
  notWritable: (file) => `motord-bus cannot write ${file}. `
    + "Download the new file, copy it to the robot, and run there:",
  copyCommand: (file, name) => `sudo cp -p ${file} ${file}.old && sudo cp ${name} ${file}`,
  downloadFile: "Download the new file",
  between: (low, high, unit) => `${low} to ${high} ${unit}`,
  values: "Values",
  words: {
    forward: "Forward", backward: "Backward", none: "No wheel turned", other: "Another wheel",
    gentle: "Gentle", normal: "Normal", brisk: "Brisk",
  },

  fleetHelp: "Robots of this page's fleet: `fleet` in each robot file names the other dashboards.",
  noRecordings: "No recordings yet.",
  noRecorders: "The robot file has no [publish.*] of kind \"mcap\": nothing is recorded.",
  recordStart: "Start recording", recordStop: "Stop recording",
  recorderModes: {
    all: "records all the time", fault: "writes a file at a fault", manual: "records",
  },
  recorderWaits: "ready", recorderFailing: "cannot write: see the log", writing: "being written",
  replay: "Replay",
  replayHelp: "Replay runs the core again on a recording with journal = true and compares every "
    + "set-point. No motor moves.",
  replayStates: {
    waits: "Waits for another replay.", runs: "The core runs again on the recording.",
  },
  identical: "Bit-identical.",
  replayed: (ticks, s, states, gaps, skipped) =>
    `${ticks} ticks, ${s} s, ${states} whole states compared`
    + (gaps || skipped ? `, ${gaps} gaps, ${skipped} ticks left out` : ""),
  differing: (n) => (n === 1 ? "1 tick differs." : `${n} ticks differ.`),
  differences: "Ticks that differ",
  tick: "Tick", field: "Field", recorded: "Recorded", replayedNow: "Replayed",

  trace: "Exchanges",
  traceShow: "Show live", traceHide: "Hide",
  traceHelp: "What goes over the line, decoded. "
    + "The robot traces a line only while a page shows it.",
  traceFailures: "Only what failed",
  traceSkipped: (n) => (n ? `${n} more not shown` : ""),
  time: "Time", result: "Result", reply: "Reply after", meaning: "Meaning", bytes: "Bytes",

  estopAll: "E-STOP for all robots",
  notReached: "This e-stop did not reach every robot. Stop these robots by hand:",
  notConnected: "not connected", needsToken: "needs its token",
  open: "Open", robot: "Robot",
  tokenFor: (robot) => `Token of ${robot}`,
  thisRobot: "this robot",
};

export const SYMBOLS = {
  m: "m", m_s: "m/s", rad: "rad", rad_s: "rad/s", a: "A", v: "V", c: "°C", s: "s", hz: "Hz",
  us: "µs", deg: "°",
};
