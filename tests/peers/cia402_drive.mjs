// SPDX-License-Identifier: Apache-2.0
// A CiA 402 drive on node-canopen: node cia402_drive.mjs NODE MODULES. Object dictionary, SDO server, NMT, heartbeat and
// PDOs are that project's; the state machine of CiA 402-2, 8.3, gets its input from them. MODULES:
// the folder of the npm packages. Its bus is one JSON object a line: {"id", "data"} in and out. In,
// too: {"set": [index, value]}, {"fault": code}. Out, too, at each change: its state and what it
// received.

import { createRequire } from "node:module";
import { createInterface } from "node:readline";

const [node, modules] = [Number(process.argv[2]), process.argv[3]];
const { AccessType, DataType, Device, Eds, ObjectType } = createRequire(`${modules}/`)("canopen");
const { UNSIGNED8: U8, UNSIGNED16: U16, UNSIGNED32: U32 } = DataType;
const { INTEGER8: I8, INTEGER16: I16, INTEGER32: I32 } = DataType;
const { READ_ONLY, READ_WRITE } = AccessType;
const { VAR, RECORD } = ObjectType;

const OFF = 0x40, READY = 0x21, SWITCHED_ON = 0x23, OPERATION = 0x27, QUICK_STOP = 0x07, FAULT = 0x08;
const STOPPING_MS = 50;
const VARIABLES = [
  [0x1017, U16, 0, READ_WRITE], [0x603f, U16, 0, READ_ONLY], [0x6040, U16, 0, READ_WRITE],
  [0x6041, U16, OFF, READ_ONLY], [0x605a, I16, 1, READ_WRITE], [0x6060, I8, 0, READ_WRITE],
  [0x6061, I8, 0, READ_ONLY], [0x6064, I32, 0, READ_ONLY], [0x606c, I32, 0, READ_ONLY],
  [0x6077, I16, 0, READ_ONLY], [0x6079, U32, 48000, READ_ONLY], [0x60ff, I32, 0, READ_WRITE],
];
const RECORDS = {
  0x1400: [U32, U8, U16, U8, U16], 0x1600: Array(8).fill(U32), 0x1800: [U32, U8, U16, U8, U16],
  0x1801: [U32, U8, U16, U8, U16], 0x1a00: Array(8).fill(U32), 0x1a01: Array(8).fill(U32),
};

const eds = new Eds({ productName: "drive" });
eds.getEntry(0x1000).value = 0x00020192;
for (const [index, dataType, defaultValue, accessType] of VARIABLES) {
  eds.addEntry(index, { parameterName: `o${index}`, objectType: VAR, dataType, defaultValue, accessType });
}
for (const [index, kinds] of Object.entries(RECORDS)) {
  eds.addEntry(Number(index), { parameterName: `o${index}`, objectType: RECORD });
  kinds.forEach((dataType, at) =>
    eds.addSubEntry(Number(index), at + 1, { parameterName: `o${index}s${at + 1}`, objectType: VAR, dataType }),
  );
}
eds.addSdoServerParameter(0, 0x580 + node, 0x600 + node);
const device = new Device({ id: node, eds });
const get = (index) => device.getValue(index);
const put = (index, value) => device.setValue(index, value);
const record = (index) => Object.keys(RECORDS[index]).map((at) => device.getValueArray(index, Number(at) + 1));

let control = 0, reported = "";
const controls = [], statuses = [OFF];

function say() {
  const now = JSON.stringify({
    nmt: device.state, status: get(0x6041), mode: get(0x6061), velocity: get(0x606c), wanted: get(0x60ff), controls,
    statuses, pdos: Object.fromEntries(Object.keys(RECORDS).map((index) => [index, record(Number(index))])),
    mapped: [0x1600, 0x1a00, 0x1a01].map((index) => device.getValueArray(index, 0)), option: get(0x605a),
  });
  if (now !== reported) {
    console.log((reported = now));
  }
}

function become(status) {
  if (status !== get(0x6041)) {
    put(0x6041, status);
    statuses.push(status);
    if (status === QUICK_STOP) {
      setTimeout(() => get(0x6041) === QUICK_STOP && become(OFF), STOPPING_MS); // 605Ah, 2
    }
  }
  put(0x606c, status === OPERATION && get(0x6061) === 3 ? get(0x60ff) : 0);
}

// CiA 402-2, table 27: one transition a command.
function after(status, word, rising) {
  if (status === FAULT) {
    return rising & 0x80 ? OFF : FAULT;
  }
  if (!(word & 0x02)) {
    return OFF;
  }
  if (!(word & 0x04)) {
    return status === OPERATION || status === QUICK_STOP ? QUICK_STOP : OFF;
  }
  if (status === QUICK_STOP) {
    return status;
  }
  if (!(word & 0x01)) {
    return READY;
  }
  if (status === OFF) {
    return OFF;
  }
  return word & 0x08 && status !== READY ? OPERATION : SWITCHED_ON;
}

function obey(word) {
  if (word !== control) {
    const rising = word & ~control;
    controls.push((control = word));
    const status = after(get(0x6041), word, rising);
    if (get(0x6041) === FAULT && status === OFF) {
      put(0x603f, 0);
    }
    become(status);
  }
  become(get(0x6041));
  say();
}

device.on("message", ({ id, data }) => console.log(JSON.stringify({ id, data: Buffer.from(data).toString("hex") })));
device.pdo.on("pdo", () => obey(get(0x6040)));
eds.getEntry(0x6040).on("update", () => obey(get(0x6040)));
eds.getEntry(0x6060).on("update", () => put(0x6061, get(0x6060)));
device.nmt.on("changeState", say);
createInterface({ input: process.stdin }).on("line", (line) => {
  const sent = JSON.parse(line);
  if (sent.id !== undefined) {
    device.receive({ id: sent.id, data: Buffer.from(sent.data, "hex") });
  } else if (sent.set !== undefined) {
    put(...sent.set);
  } else {
    put(0x603f, sent.fault);
    become(FAULT);
  }
  say();
}).on("close", () => process.exit(0));
device.start();
say();
