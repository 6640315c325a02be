// SPDX-License-Identifier: Apache-2.0
// Foxglove's own client: node foxglove_client.mjs URL MODULES. Prints the server's information,
// its channels, and the first message of /odom. MODULES: the folder of the npm packages.

import { createRequire } from "node:module";

const WITHIN_MS = 30000;
const [url, modules] = process.argv.slice(2);
const require = createRequire(`${modules}/`);
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const WebSocket = require("ws");

// The client is older than the server's name of the protocol.
FoxgloveClient.SUPPORTED_SUBPROTOCOL = "foxglove.sdk.v1";
setTimeout(() => process.exit(1), WITHIN_MS).unref();
const seen = { channels: {} };
const client = new FoxgloveClient({ ws: new WebSocket(url, ["foxglove.sdk.v1"]) });
client.on("serverInfo", (info) => (seen.server = info));
client.on("error", (error) => console.error(error));
client.on("advertise", (channels) => {
  for (const channel of channels) {
    seen.channels[channel.topic] = channel.schemaName;
    if (channel.topic === "/odom") {
      client.subscribe(channel.id);
    }
  }
});
client.on("message", ({ data }) => {
  seen.odom = Buffer.from(data.buffer, data.byteOffset, data.byteLength).toString("hex");
  console.log(JSON.stringify(seen, (_, value) => (typeof value === "bigint" ? `${value}` : value)));
  process.exit(0);
});
