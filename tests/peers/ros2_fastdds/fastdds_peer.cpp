// SPDX-License-Identifier: Apache-2.0
// A participant on eProsima Fast DDS. Its types are written by hand for Fast CDR. It shares no code with motord.
//   fastdds_peer DOMAIN odom TOPIC           prints a line "x v frame child" for each nav_msgs/Odometry
//   fastdds_peer DOMAIN drive TOPIC V W      sends 20 geometry_msgs/TwistStamped a second
//   fastdds_peer DOMAIN joints TOPIC L R     sends 20 sensor_msgs/JointState a second: velocities of "left" and "right"
//   fastdds_peer DOMAIN text TOPIC           prints the beginning of each latched std_msgs/String
//   fastdds_peer DOMAIN say TOPIC TEXT NODE  sends 20 std_msgs/String a second, from NODE in the graph
//   fastdds_peer DOMAIN ask NAME NODE        is a client of the service NAME (std_srvs/Trigger) as rmw_fastrtps makes it, in
//                                            NODE; sends 20 requests a second, and prints "READERS WRITERS" that it has found
// c++ -std=c++17 fastdds_peer.cpp -o fastdds_peer -lfastrtps -lfastcdr     (apt install libfastrtps-dev)
#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <fastcdr/Cdr.h>
#include <fastcdr/FastBuffer.h>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>
#include <memory>
#include <string>
#include <thread>
#include <vector>

using namespace eprosima::fastdds::dds;
using eprosima::fastcdr::Cdr;
using eprosima::fastcdr::FastBuffer;
using eprosima::fastrtps::rtps::InstanceHandle_t;
using eprosima::fastrtps::rtps::SerializedPayload_t;

struct Header {
    int32_t sec = 0;
    uint32_t nanosec = 0;
    std::string frame_id;
};

struct Odometry {
    Header header;
    std::string child_frame_id;
    std::array<double, 7> pose{};
    std::array<double, 36> pose_covariance{};
    std::array<double, 6> twist{};
    std::array<double, 36> twist_covariance{};
    static const char *type() { return "nav_msgs::msg::dds_::Odometry_"; }
};

struct TwistStamped {
    Header header;
    std::array<double, 6> twist{};
    static const char *type() { return "geometry_msgs::msg::dds_::TwistStamped_"; }
};

struct JointState {
    Header header;
    std::vector<std::string> name;
    std::vector<double> position, velocity, effort;
    static const char *type() { return "sensor_msgs::msg::dds_::JointState_"; }
};

struct String {
    Header header; // is not sent
    std::string data;
    static const char *type() { return "std_msgs::msg::dds_::String_"; }
};

// A request without fields has one byte. The identity of its sender is sent with the message.
struct TriggerRequest {
    uint8_t nothing = 0;
    static const char *type() { return "std_srvs::srv::dds_::Trigger_Request_"; }
};

struct TriggerReply {
    uint8_t success = 0;
    std::string message;
    static const char *type() { return "std_srvs::srv::dds_::Trigger_Response_"; }
};

// The graph message of Iron and later: one node with two endpoints.
struct Entities {
    std::array<uint8_t, 16> gid{};
    std::string node_namespace = "/", node_name;
    std::vector<std::array<uint8_t, 16>> readers, writers;
    static const char *type() { return "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"; }
};

// `Archive` is a Cdr that writes or reads.
template <typename Field> static void pass(Cdr &cdr, Field &field, bool writing) { writing ? cdr << field : cdr >> field; }
static void pass(Cdr &cdr, Header &header, bool writing)
{
    pass(cdr, header.sec, writing);
    pass(cdr, header.nanosec, writing);
    pass(cdr, header.frame_id, writing);
}
static void pass(Cdr &cdr, Odometry &odometry, bool writing)
{
    pass(cdr, odometry.header, writing);
    pass(cdr, odometry.child_frame_id, writing);
    pass(cdr, odometry.pose, writing);
    pass(cdr, odometry.pose_covariance, writing);
    pass(cdr, odometry.twist, writing);
    pass(cdr, odometry.twist_covariance, writing);
}
static void pass(Cdr &cdr, TwistStamped &command, bool writing)
{
    pass(cdr, command.header, writing);
    pass(cdr, command.twist, writing);
}
static void pass(Cdr &cdr, JointState &command, bool writing)
{
    pass(cdr, command.header, writing);
    pass(cdr, command.name, writing);
    pass(cdr, command.position, writing);
    pass(cdr, command.velocity, writing);
    pass(cdr, command.effort, writing);
}

static void pass(Cdr &cdr, String &text, bool writing) { pass(cdr, text.data, writing); }
static void pass(Cdr &cdr, TriggerRequest &request, bool writing) { pass(cdr, request.nothing, writing); }
static void pass(Cdr &cdr, TriggerReply &reply, bool writing)
{
    pass(cdr, reply.success, writing);
    pass(cdr, reply.message, writing);
}
static void pass(Cdr &cdr, Entities &entities, bool writing)
{
    uint32_t nodes = 1;
    pass(cdr, entities.gid, writing);
    pass(cdr, nodes, writing);
    pass(cdr, entities.node_namespace, writing);
    pass(cdr, entities.node_name, writing);
    for (auto *endpoints : {&entities.readers, &entities.writers}) {
        uint32_t count = static_cast<uint32_t>(endpoints->size());
        pass(cdr, count, writing);
        endpoints->resize(count);
        for (auto &gid : *endpoints)
            pass(cdr, gid, writing);
    }
}

template <typename Message> class Type : public TopicDataType {
  public:
    Type()
    {
        setName(Message::type());
        m_typeSize = 65536;
        m_isGetKeyDefined = false;
    }
    bool serialize(void *data, SerializedPayload_t *payload) override
    {
        FastBuffer buffer(reinterpret_cast<char *>(payload->data), payload->max_size);
        Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
        payload->encapsulation = CDR_LE;
        cdr.serialize_encapsulation();
        pass(cdr, *static_cast<Message *>(data), true);
        payload->length = static_cast<uint32_t>(cdr.getSerializedDataLength());
        return true;
    }
    bool deserialize(SerializedPayload_t *payload, void *data) override
    {
        FastBuffer buffer(reinterpret_cast<char *>(payload->data), payload->length);
        Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
        cdr.read_encapsulation();
        pass(cdr, *static_cast<Message *>(data), false);
        return true;
    }
    std::function<uint32_t()> getSerializedSizeProvider(void *) override { return [this] { return m_typeSize; }; }
    void *createData() override { return new Message; }
    void deleteData(void *data) override { delete static_cast<Message *>(data); }
    bool getKey(void *, InstanceHandle_t *, bool) override { return false; }
};

// Discovers only the first four participants on this machine.
static DomainParticipant *participant(unsigned domain)
{
    auto transport = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
    transport->interfaceWhiteList.push_back("127.0.0.1");
    DomainParticipantQos qos;
    qos.transport().use_builtin_transports = false;
    qos.transport().user_transports.push_back(transport);
    eprosima::fastrtps::rtps::Locator_t here;
    eprosima::fastrtps::rtps::IPLocator::setIPv4(here, "127.0.0.1");
    qos.wire_protocol().builtin.initialPeersList.push_back(here);
    return DomainParticipantFactory::get_instance()->create_participant(domain, qos);
}

template <typename Message> static Topic *topic(DomainParticipant *of, const char *name)
{
    TypeSupport type(new Type<Message>);
    type.register_type(of);
    return of->create_topic(name, Message::type(), TOPIC_QOS_DEFAULT);
}

static void show(const Odometry &odometry)
{
    printf("%.6f %.6f %s %s\n", odometry.pose[0], odometry.twist[0], odometry.header.frame_id.c_str(),
           odometry.child_frame_id.c_str());
}
static void show(const String &text) { printf("%.12s\n", text.data.c_str()); }

template <typename Message> static int hear(DomainParticipant *of, const char *name, DurabilityQosPolicyKind durability)
{
    DataReaderQos qos;
    qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
    qos.durability().kind = durability;
    DataReader *reader = of->create_subscriber(SUBSCRIBER_QOS_DEFAULT)->create_datareader(topic<Message>(of, name), qos);
    for (Message message;;) {
        SampleInfo info;
        if (!reader->wait_for_unread_message({1, 0}))
            continue;
        while (reader->take_next_sample(&message, &info) == ReturnCode_t::RETCODE_OK && info.valid_data) {
            show(message);
            fflush(stdout);
        }
    }
}

static std::array<uint8_t, 16> gid(const eprosima::fastrtps::rtps::GUID_t &guid)
{
    std::array<uint8_t, 16> made{};
    std::copy_n(guid.guidPrefix.value, 12, made.begin());
    std::copy_n(guid.entityId.value, 4, made.begin() + 12);
    return made;
}

// Publishes a node with these endpoints in the graph.
static void tell(DomainParticipant *of, Publisher *publisher, const char *node, const DataReader *reader, const DataWriter *writer)
{
    DataWriterQos qos;
    qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
    qos.durability().kind = TRANSIENT_LOCAL_DURABILITY_QOS;
    Entities own;
    own.gid = gid(of->guid());
    own.node_name = node;
    if (reader != nullptr)
        own.readers = {gid(reader->guid())};
    own.writers = {gid(writer->guid())};
    publisher->create_datawriter(topic<Entities>(of, "ros_discovery_info"), qos)->write(&own);
}

template <typename Message> static int send(DomainParticipant *of, const char *name, Message command, const char *node = nullptr)
{
    DataWriterQos qos;
    qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
    Publisher *publisher = of->create_publisher(PUBLISHER_QOS_DEFAULT);
    DataWriter *writer = publisher->create_datawriter(topic<Message>(of, name), qos);
    if (node != nullptr)
        tell(of, publisher, node, nullptr, writer);
    for (;;) {
        auto now_ns = std::chrono::system_clock::now().time_since_epoch() / std::chrono::nanoseconds(1);
        command.header.sec = static_cast<int32_t>(now_ns / 1000000000);
        command.header.nanosec = static_cast<uint32_t>(now_ns % 1000000000);
        writer->write(&command);
        std::this_thread::sleep_for(std::chrono::milliseconds(50));
    }
}

static int ask(DomainParticipant *of, const std::string &name, const char *node)
{
    DataWriterQos writes;
    DataReaderQos reads;
    writes.reliability().kind = RELIABLE_RELIABILITY_QOS;
    reads.reliability().kind = RELIABLE_RELIABILITY_QOS;
    Publisher *publisher = of->create_publisher(PUBLISHER_QOS_DEFAULT);
    DataReader *replies = of->create_subscriber(SUBSCRIBER_QOS_DEFAULT)
                              ->create_datareader(topic<TriggerReply>(of, ("rr" + name + "Reply").c_str()), reads);
    DataWriter *requests =
        publisher->create_datawriter(topic<TriggerRequest>(of, ("rq" + name + "Request").c_str()), writes);
    tell(of, publisher, node, replies, requests);
    for (TriggerRequest request;;) {
        PublicationMatchedStatus readers;
        SubscriptionMatchedStatus writers;
        requests->get_publication_matched_status(readers);
        replies->get_subscription_matched_status(writers);
        printf("%d %d\n", readers.current_count, writers.current_count);
        fflush(stdout);
        requests->write(&request);
        std::this_thread::sleep_for(std::chrono::milliseconds(50));
    }
}

int main(int count, char **words)
{
    if (count < 4)
        return 2;
    DomainParticipant *own = participant(static_cast<unsigned>(atoi(words[1])));
    if (own == nullptr)
        return 1;
    if (std::string(words[2]) == "odom")
        return hear<Odometry>(own, words[3], VOLATILE_DURABILITY_QOS);
    if (std::string(words[2]) == "text")
        return hear<String>(own, words[3], TRANSIENT_LOCAL_DURABILITY_QOS);
    if (count < 5)
        return 2;
    if (std::string(words[2]) == "ask")
        return ask(own, words[3], words[4]);
    if (count < 6)
        return 2;
    if (std::string(words[2]) == "say")
        return send(own, words[3], String{{}, words[4]}, words[5]);
    if (std::string(words[2]) == "joints")
        return send(own, words[3], JointState{{}, {"left", "right"}, {}, {atof(words[4]), atof(words[5])}, {}});
    return send(own, words[3], TwistStamped{{}, {atof(words[4]), 0, 0, 0, 0, atof(words[5])}});
}
