/* As much of Embree's 4.3 interface as a bench in C asks for; values and layouts as in the crate embree4-sys
   in this tree, whose tests hold them against the library.
   Invariant: fits every Embree from 4.3 on, below 5, with one instance level. Never: used by Weir itself. */
#pragma once
#include <stdbool.h>
#include <stddef.h>
#include <sys/types.h>

#define RTC_INVALID_GEOMETRY_ID ((unsigned)-1)

typedef struct RTCDeviceTy *RTCDevice;
typedef struct RTCSceneTy *RTCScene;
typedef struct RTCGeometryTy *RTCGeometry;

enum RTCDeviceProperty { RTC_DEVICE_PROPERTY_VERSION = 0, RTC_DEVICE_PROPERTY_BACKFACE_CULLING_ENABLED = 65 };
enum RTCSceneFlags { RTC_SCENE_FLAG_COMPACT = 2, RTC_SCENE_FLAG_ROBUST = 4 };
enum RTCBuildQuality { RTC_BUILD_QUALITY_HIGH = 2 };
enum RTCGeometryType { RTC_GEOMETRY_TYPE_TRIANGLE = 0 };
enum RTCBufferType { RTC_BUFFER_TYPE_INDEX = 0, RTC_BUFFER_TYPE_VERTEX = 1 };
enum RTCFormat { RTC_FORMAT_UINT3 = 0x5003, RTC_FORMAT_FLOAT3 = 0x9003 };

struct __attribute__((aligned(16))) RTCRay {
  float org_x, org_y, org_z, tnear, dir_x, dir_y, dir_z, time, tfar;
  unsigned mask, id, flags;
};
struct __attribute__((aligned(16))) RTCHit {
  float Ng_x, Ng_y, Ng_z, u, v;
  unsigned primID, geomID, instID[1], instPrimID[1];
};
struct RTCRayHit {
  struct RTCRay ray;
  struct RTCHit hit;
};
_Static_assert(sizeof(struct RTCRayHit) == 96, "the record of Embree 4.3 and later");

struct RTCIntersectArguments;
struct RTCOccludedArguments;

RTCDevice rtcNewDevice(const char *config);
ssize_t rtcGetDeviceProperty(RTCDevice, enum RTCDeviceProperty);
RTCScene rtcNewScene(RTCDevice);
void rtcSetSceneFlags(RTCScene, enum RTCSceneFlags);
void rtcSetSceneBuildQuality(RTCScene, enum RTCBuildQuality);
void rtcCommitScene(RTCScene);
RTCGeometry rtcNewGeometry(RTCDevice, enum RTCGeometryType);
void *rtcSetNewGeometryBuffer(RTCGeometry, enum RTCBufferType, unsigned slot, enum RTCFormat, size_t stride,
                              size_t count);
void rtcCommitGeometry(RTCGeometry);
unsigned rtcAttachGeometry(RTCScene, RTCGeometry);
void rtcReleaseGeometry(RTCGeometry);
void rtcIntersect1(RTCScene, struct RTCRayHit *, struct RTCIntersectArguments *);
void rtcOccluded1(RTCScene, struct RTCRay *, struct RTCOccludedArguments *);
