// SPDX-License-Identifier: Apache-2.0
// A user's program on roslibjs: node ros_client.mjs URL ROSLIB. Prints what it received.
// ROSLIB: the library's file.

const WITHIN_MS = 30000;
const [url, roslib] = process.argv.slice(2);
const { Ros, Service, Topic } = await import(roslib);

function within(what, start) {
  return new Promise((resolve, reject) => {
    setTimeout(() => reject(new Error(`no ${what}`)), WITHIN_MS).unref();
    start(resolve, reject);
  });
}

const ros = new Ros();
await within("connection", (resolve, reject) => {
  ros.on("connection", resolve);
  ros.on("error", reject);
  ros.connect(url);
});

function received(name, messageType, fits) {
  const topic = new Topic({ ros, name, messageType });
  return within(name, (resolve) =>
    topic.subscribe((message) => {
      if (fits(message)) {
        topic.unsubscribe();
        resolve(message);
      }
    }),
  );
}

function trigger(name) {
  const service = new Service({ ros, name, serviceType: "std_srvs/Trigger" });
  return within(name, (resolve, reject) => service.callService({}, resolve, reject));
}

const seen = {
  topics: (await within("topics", (resolve, reject) => ros.getTopics(resolve, reject))).topics,
  odom: await received("/odom", "nav_msgs/Odometry", () => true),
  arm: await trigger("/arm"),
};
const cmdVel = new Topic({ ros, name: "/cmd_vel", messageType: "geometry_msgs/Twist" });
const drive = (x) => cmdVel.publish({ linear: { x, y: 0, z: 0 }, angular: { x: 0, y: 0, z: 0 } });
const driver = setInterval(() => drive(0.2), 50);
seen.motor_status = await received(
  "/motor_status",
  "motord_msgs/MotorStatus",
  (message) => message.commander === "web" && message.state === "moving",
);
clearInterval(driver);
seen.estop = await trigger("/estop");
drive(0);
const end = Date.now() + WITHIN_MS;
do {
  seen.reset = await trigger("/reset"); // retried until the zero command has arrived
} while (!seen.reset.success && Date.now() < end);
console.log(JSON.stringify(seen));
ros.close();
