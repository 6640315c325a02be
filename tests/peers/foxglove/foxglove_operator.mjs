// SPDX-License-Identifier: Apache-2.0
// A program on Foxglove's own client that drives: node foxglove_operator.mjs URL MODULES TOKEN.
// Prints what it received. MODULES: the folder of the npm packages.

import { createRequire } from "node:module";

const WITHIN_MS = 60000;
const [url, modules, token] = process.argv.slice(2);
const require = createRequire(`${modules}/`);
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const WebSocket = require("ws");

// The client is older than the server's name of the protocol.
FoxgloveClient.SUPPORTED_SUBPROTOCOL = "foxglove.sdk.v1";
const seen = {};
setTimeout(() => {
  console.error(JSON.stringify({ ...seen, odometry }));
  process.exit(1);
}, WITHIN_MS).unref();
const client = new FoxgloveClient({ ws: new WebSocket(url, ["foxglove.sdk.v1"]) });
const text = { to: new TextEncoder(), from: new TextDecoder() };
const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
const once = (event, fits) =>
  new Promise((resolve) => {
    const take = (message) => {
      if (fits(message)) {
        client.off(event, take);
        resolve(message);
      }
    };
    client.on(event, take);
  });

const services = new Map();
client.on("advertiseServices", (list) => {
  for (const { name, id } of list) {
    services.set(name, id);
  }
});
let odometry;
client.on("advertise", (channels) => {
  for (const { topic, id } of channels) {
    if (topic === "/odom") {
      client.subscribe(id);
    }
  }
});
// A CDR message of nav_msgs/Odometry: forward speed is the first number of the twist, which is
// followed by 5 others and 36 covariances.
client.on("message", ({ data }) => {
  odometry = data.getFloat64(data.byteLength - 42 * 8, true);
});

let calls = 0;
async function call(name, request) {
  const callId = ++calls;
  const data = new DataView(text.to.encode(JSON.stringify(request)).buffer);
  client.sendServiceCallRequest({ serviceId: services.get(name), callId, encoding: "json", data });
  const answer = await once("serviceCallResponse", (message) => message.callId === callId);
  return JSON.parse(text.from.decode(answer.data));
}

await once("advertiseServices", () => true);
await pause(0); // until the other listener has handled them too
seen.services = [...services.keys()];
seen.refused = await call("/arm", {});
await call("/authorize", { token });
// Until the earlier client's lease has ended, and no drive looks unresponsive on a busy machine.
async function arm() {
  while (!(seen.arm = await call("/arm", {})).success) {
    await call("/reset", {});
  }
}
await arm();
const channel = client.advertise({
  topic: "/cmd_vel",
  encoding: "json",
  schemaName: "geometry_msgs/msg/Twist",
});
const drive = (x) => {
  const twist = { linear: { x, y: 0, z: 0 }, angular: { x: 0, y: 0, z: 0 } };
  client.sendMessage(channel, text.to.encode(JSON.stringify(twist)));
};
for (let count = 1; !(odometry > 0.05); count++) {
  if (count % 100 === 0) {
    await arm();
  }
  drive(0.2);
  await pause(50);
}
seen.moved = true;
seen.estop = await call("/estop", {});
do {
  drive(0);
  seen.reset = await call("/reset", {}); // until it is at rest
} while (!seen.reset.success);
client.setParameters([{ name: "limits.linear_m_s", value: 0.25 }], "mine");
seen.limit = (await once("parameterValues", ({ id }) => id === "mine")).parameters;
console.log(JSON.stringify(seen));
process.exit(0);
