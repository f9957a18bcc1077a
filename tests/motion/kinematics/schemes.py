"""How programs and data sets name the joints of a body."""

from tests.motion.kinematics.scheme import Scheme

_UNREAL = Scheme(
    "=root/hips=pelvis/spine=spine_01/chest=spine_02/upperChest=spine_03/neck=neck_01/head=head",
    "Shoulder=clavicle_{s}/UpperArm=upperarm_{s}/LowerArm=lowerarm_{s}/Hand=hand_{s}",
    "UpperLeg=thigh_{s}/LowerLeg=calf_{s}/Foot=foot_{s}/Toes=ball_{s}",
    ("l", "r"),
    "{digit}_0{k}_{s}",
    "thumb index middle ring pinky",
)
_MIXAMO = Scheme(
    "hips=Hips/spine=Spine/chest=Spine1/upperChest=Spine2/neck=Neck/head=Head",
    "Shoulder={s}Shoulder/UpperArm={s}Arm/LowerArm={s}ForeArm/Hand={s}Hand",
    "UpperLeg={s}UpLeg/LowerLeg={s}Leg/Foot={s}Foot/Toes={s}ToeBase",
    ("Left", "Right"),
    "{s}Hand{digit}{k}",
)
_RIGIFY = Scheme(
    "=root/hips=spine/spine=spine.001/chest=spine.002/upperChest=spine.003/neck=spine.004/=spine.005/head=spine.006",
    "Shoulder=shoulder.{s}/UpperArm=upper_arm.{s}/=upper_arm.{s}.001/LowerArm=forearm.{s}/Hand=hand.{s}",
    "UpperLeg=thigh.{s}/=thigh.{s}.001/LowerLeg=shin.{s}/=shin.{s}.001/Foot=foot.{s}/Toes=toe.{s}",
    ("L", "R"),
    "{digit}.0{k}.{s}",
    "thumb f_index f_middle f_ring f_pinky",
    palm="palm.0{n}.{s}",
    has_all_names=False,
)
_BIPED = Scheme(
    "=Bip001/hips=Bip001 Pelvis/spine=Bip001 Spine/chest=Bip001 Spine1/upperChest=Bip001 Spine2/neck=Bip001 Neck"
    "/head=Bip001 Head",
    "Shoulder={s} Clavicle/UpperArm={s} UpperArm/LowerArm={s} Forearm/Hand={s} Hand",
    "UpperLeg={s} Thigh/LowerLeg={s} Calf/Foot={s} Foot/Toes={s} Toe0",
    ("Bip001 L", "Bip001 R"),
    "{s} Finger{n}{j}",
    arms_at="Bip001 Neck",
    legs_at="Bip001 Spine",
)
_UNITY = Scheme(
    "hips=Hips/spine=Spine/chest=Chest/upperChest=UpperChest/neck=Neck/head=Head",
    "Shoulder={s}Shoulder/UpperArm={s}UpperArm/LowerArm={s}LowerArm/Hand={s}Hand",
    "UpperLeg={s}UpperLeg/LowerLeg={s}LowerLeg/Foot={s}Foot/Toes={s}Toes",
    ("Left", "Right"),
    "{s}{digit}{bit}",
    "Thumb Index Middle Ring Little",
)
_CREATOR = Scheme(
    "=CC_Base_BoneRoot/hips=CC_Base_Hip/spine=CC_Base_Waist/chest=CC_Base_Spine01/upperChest=CC_Base_Spine02"
    "/neck=CC_Base_NeckTwist01/=CC_Base_NeckTwist02/head=CC_Base_Head",
    "Shoulder={s}_Clavicle/UpperArm={s}_Upperarm/LowerArm={s}_Forearm/Hand={s}_Hand",
    "=CC_Base_Pelvis/UpperLeg={s}_Thigh/LowerLeg={s}_Calf/Foot={s}_Foot/Toes={s}_ToeBase",
    ("CC_Base_L", "CC_Base_R"),
    "{s}_{digit}{k}",
    "Thumb Index Mid Ring Pinky",
)
_SMPLX = Scheme(
    "hips=pelvis/spine=spine1/chest=spine2/upperChest=spine3/neck=neck/head=head",
    "Shoulder={s}_collar/UpperArm={s}_shoulder/LowerArm={s}_elbow/Hand={s}_wrist",
    "UpperLeg={s}_hip/LowerLeg={s}_knee/Foot={s}_ankle/Toes={s}_foot",
    ("left", "right"),
    "{s}_{digit}{k}",
    "thumb index middle ring pinky",
)
_GENESIS8 = Scheme(
    "hips=hip/spine=abdomenLower/chest=abdomenUpper/=chestLower/upperChest=chestUpper/neck=neckLower/=neckUpper/head=head",
    "Shoulder={s}Collar/UpperArm={s}ShldrBend/={s}ShldrTwist/LowerArm={s}ForearmBend/={s}ForearmTwist/Hand={s}Hand",
    "=pelvis/UpperLeg={s}ThighBend/={s}ThighTwist/LowerLeg={s}Shin/Foot={s}Foot/={s}Metatarsals/Toes={s}Toe",
    ("l", "r"),
    "{s}{digit}{k}",
    "Thumb Index Mid Ring Pinky",
)
_OPEN_XR = Scheme(
    "=Root/hips=Hips/spine=Spine_Lower/chest=Spine_Middle/=Spine_Upper/upperChest=Chest/neck=Neck/head=Head",
    "=Shoulder_{s}/Shoulder=Scapula_{s}/UpperArm=Arm_Upper_{s}/LowerArm=Arm_Lower_{s}/=Hand_Wrist_Twist_{s}/Hand=Hand_Wrist_{s}",
    "UpperLeg=Upper_Leg_{s}/LowerLeg=Lower_Leg_{s}/=Foot_Ankle_Twist_{s}/Foot=Foot_Ankle_{s}/=Foot_Subtalar_{s}"
    "/=Foot_Transverse_{s}/Toes=Foot_Ball_{s}",
    ("Left", "Right"),
    "Hand_{digit}_{bit}_{s}",
    "Thumb Index Middle Ring Little",
    palm="Hand_{digit}_Metacarpal_{s}",
)
_DANCE = Scheme(
    "=全ての親/=センター/=グルーブ/hips=腰/spine=上半身/chest=上半身2/neck=首/head=頭",
    "={s}肩P/Shoulder={s}肩/={s}肩C/UpperArm={s}腕/={s}腕捩/LowerArm={s}ひじ/={s}手捩/Hand={s}手首",
    "=下半身/UpperLeg={s}足/LowerLeg={s}ひざ/Foot={s}足首/Toes={s}つま先",
    ("左", "右"),
    "{s}{digit}{k}",
    "親指 人指 中指 薬指 小指",
)
_DANCE_ENGLISH = Scheme(
    "=mother/=center/hips=waist/spine=upper body/chest=upper body2/neck=neck/head=head",
    "Shoulder=shoulder_{s}/UpperArm=arm_{s}/LowerArm=elbow_{s}/Hand=wrist_{s}",
    "=lower body/UpperLeg=leg_{s}/LowerLeg=knee_{s}/Foot=ankle_{s}/Toes=toe_{s}",
    ("L", "R"),
    "{digit}{k}_{s}",
    "thumb fore middle third little",
)
FRAMED = {  # schemes that differ by what stands around each name
    "Mixamo": (_MIXAMO, "mixamorig:{}"),
    "Mixamo in three.js": (_MIXAMO, "mixamorig{}"),
    "Mixamo, the second of a file": (_MIXAMO, "mixamorig1:{}"),
    "MotionBuilder": (_MIXAMO, "Actor1:{}"),
    "HumanIK": (_MIXAMO, "Character1_{}"),
    "two namespaces of Maya": (_MIXAMO, "scene:left_actor:{}"),
    "a path of Maya": (_MIXAMO, "|group|left|{}"),
    "Ready Player Me": (_MIXAMO, "{}"),
    "Mixamo at Sketchfab": (_MIXAMO, "mixamorig:{}_012"),
    "OpenXR of Meta": (_OPEN_XR, "XR_FULL_BODY_JOINT_{}_META"),
    "controls alone": (_UNREAL, "{}_ctrl"),
    "a label of a word for a part": (_MIXAMO, "Body_{}"),
    "a label of a side and a part": (_MIXAMO, "left_hand_{}"),
    "Rigify": (_RIGIFY, "DEF-{}"),
    "metarig of Blender": (_RIGIFY, "{}"),
}
SCHEMES: dict[str, Scheme] = {
    "Unreal 4": _UNREAL,
    "Unreal, other case": _UNREAL._replace(
        arm="Shoulder=Clavicle_{s}/UpperArm=UpperArm_{s}/LowerArm=LowerArm_{s}/Hand=Hand_{s}",
        leg="UpperLeg=Thigh_{s}/LowerLeg=Calf_{s}/Foot=Foot_{s}/Toes=Ball_{s}",
        sides=("L", "R"),
    ),
    "Unreal 5": _UNREAL._replace(
        trunk="=root/hips=pelvis/spine=spine_01/=spine_02/chest=spine_03/=spine_04/upperChest=spine_05/neck=neck_01"
        "/=neck_02/head=head",
        palm="{digit}_metacarpal_{s}",
    ),
    "3ds Max": _BIPED,
    "Rocketbox": Scheme(*(one.replace("Bip001 ", "Bip01_").replace("Bip001", "Bip01").replace("} ", "}_")
                          if isinstance(one, str) else one for one in _BIPED[:3]),
                        ("Bip01_L", "Bip01_R"), "{s}_Finger{n}{j}"),
    "Source": Scheme(
        "hips=ValveBiped.Bip01_Pelvis/spine=ValveBiped.Bip01_Spine/chest=ValveBiped.Bip01_Spine1/=ValveBiped.Bip01_Spine2"
        "/upperChest=ValveBiped.Bip01_Spine4/neck=ValveBiped.Bip01_Neck1/head=ValveBiped.Bip01_Head1",
        "Shoulder={s}_Clavicle/UpperArm={s}_UpperArm/LowerArm={s}_Forearm/Hand={s}_Hand",
        "UpperLeg={s}_Thigh/LowerLeg={s}_Calf/Foot={s}_Foot/Toes={s}_Toe0",
        ("ValveBiped.Bip01_L", "ValveBiped.Bip01_R"),
        "{s}_Finger{n}{j}",
    ),
    "VRoid": Scheme(
        "=Root/hips=J_Bip_C_Hips/spine=J_Bip_C_Spine/chest=J_Bip_C_Chest/upperChest=J_Bip_C_UpperChest"
        "/neck=J_Bip_C_Neck/head=J_Bip_C_Head",
        "Shoulder={s}_Shoulder/UpperArm={s}_UpperArm/LowerArm={s}_LowerArm/Hand={s}_Hand",
        "UpperLeg={s}_UpperLeg/LowerLeg={s}_LowerLeg/Foot={s}_Foot/Toes={s}_ToeBase",
        ("J_Bip_L", "J_Bip_R"),
        "{s}_{digit}{k}",
        "Thumb Index Middle Ring Little",
    ),
    "Rigify in three.js": _RIGIFY._replace(
        trunk=_RIGIFY.trunk.replace(".", "").replace("=spine", "=DEF-spine"),
        arm="Shoulder=DEF-shoulder{s}/UpperArm=DEF-upper_arm{s}/=DEF-upper_arm{s}001/LowerArm=DEF-forearm{s}"
        "/Hand=DEF-hand{s}",
        leg="UpperLeg=DEF-thigh{s}/=DEF-thigh{s}001/LowerLeg=DEF-shin{s}/Foot=DEF-foot{s}/Toes=DEF-toe{s}",
        fingers="DEF-{digit}0{k}{s}",
        palm="",
    ),
    "Character Creator and AccuRig": _CREATOR,
    "SMPL-X and BEAT2": _SMPLX,
    "SMPL": _SMPLX._replace(arm=_SMPLX.arm + "/={s}_hand", fingers=""),
    "SMPL as FBX": _SMPLX._replace(
        trunk="=m_avg_root/hips=m_avg_Pelvis/spine=m_avg_Spine1/chest=m_avg_Spine2/upperChest=m_avg_Spine3"
        "/neck=m_avg_Neck/head=m_avg_Head",
        arm="Shoulder={s}_Collar/UpperArm={s}_Shoulder/LowerArm={s}_Elbow/Hand={s}_Wrist/={s}_Hand",
        leg="UpperLeg={s}_Hip/LowerLeg={s}_Knee/Foot={s}_Ankle/Toes={s}_Foot",
        sides=("m_avg_L", "m_avg_R"),
        fingers="",
    ),
    "Unity": _UNITY,
    "Unity, with spaces": _UNITY._replace(
        arm="Shoulder={s} Shoulder/UpperArm={s} Upper Arm/LowerArm={s} Lower Arm/Hand={s} Hand",
        leg="UpperLeg={s} Upper Leg/LowerLeg={s} Lower Leg/Foot={s} Foot/Toes={s} Toes",
        fingers="{s} {digit} {bit}",
    ),
    "VRM": Scheme(
        "hips=hips/spine=spine/chest=chest/upperChest=upperChest/neck=neck/head=head",
        *("/".join(f"{bone}={{s}}{bone}" for bone in bones) for bones in (
            ("Shoulder", "UpperArm", "LowerArm", "Hand"), ("UpperLeg", "LowerLeg", "Foot", "Toes"))),
        ("left", "right"),
        "{s}{digit}{bit}",
        "Thumb Index Middle Ring Little",
    ),
    "side first": _UNREAL._replace(
        arm="Shoulder={s}_clavicle/UpperArm={s}_upper_arm/LowerArm={s}_forearm/Hand={s}_hand",
        leg="UpperLeg={s}_thigh/LowerLeg={s}_shin/Foot={s}_foot/Toes={s}_toe",
        sides=("L", "R"),
    ),
    "hyphens": _UNREAL._replace(
        arm="Shoulder=clavicle-{s}/UpperArm=upper-arm-{s}/LowerArm=lower-arm-{s}/Hand=hand-{s}",
        leg="UpperLeg=thigh-{s}/LowerLeg=shin-{s}/Foot=foot-{s}/Toes=toe-{s}",
        sides=("L", "R"),
        fingers="{digit}-{k}-{s}",
    ),
    "run together": _UNITY._replace(
        arm="Shoulder={s}shoulder/UpperArm={s}upperarm/LowerArm={s}lowerarm/Hand={s}hand",
        leg="UpperLeg={s}upperleg/LowerLeg={s}lowerleg/Foot={s}foot/Toes={s}toe",
        sides=("left", "right"),
        fingers="{s}{digit}{k}",
        digits="thumb index middle ring little",
    ),
    "side in the middle": _UNREAL._replace(
        arm="Shoulder=arm {s} shoulder 1/UpperArm=arm {s} shoulder 2/LowerArm=arm {s} elbow/Hand=arm {s} wrist",
        leg="UpperLeg=leg {s} thigh/LowerLeg=leg {s} knee/Foot=leg {s} ankle/Toes=leg {s} toes",
        sides=("left", "right"),
        fingers="arm {s} finger {k0}{letter}",
    ),
    "Genesis 3 and 8": _GENESIS8,
    "Genesis 9": _GENESIS8._replace(
        trunk="hips=hip/spine=spine1/chest=spine2/=spine3/upperChest=spine4/neck=neck1/=neck2/head=head",
        arm="Shoulder={s}_shoulder/UpperArm={s}_upperarm/LowerArm={s}_forearm/Hand={s}_hand",
        leg="=pelvis/UpperLeg={s}_thigh/LowerLeg={s}_shin/Foot={s}_foot/={s}_metatarsals/Toes={s}_toes",
        fingers="{s}_{digit}{k}",
        digits="thumb index mid ring pinky",
        palm="{s}_{digit}metacarpal",
    ),
    "Poser": _GENESIS8._replace(
        trunk="=Body/hips=Hip/spine=Abdomen/chest=Chest/neck=Neck/head=Head",
        arm="Shoulder={s} Collar/UpperArm={s} Shoulder/LowerArm={s} Forearm/Hand={s} Hand",
        leg="={s} Buttock/UpperLeg={s} Thigh/LowerLeg={s} Shin/Foot={s} Foot/Toes={s} Toe",
        sides=("Left", "Right"),
        fingers="{s} {digit} {k}",
    ),
    "Poser inside": _GENESIS8._replace(
        trunk="hips=hip/spine=abdomen/chest=chest/neck=neck/head=head",
        arm="Shoulder={s}Collar/UpperArm={s}Shldr/LowerArm={s}ForeArm/Hand={s}Hand",
        leg="={s}Buttock/UpperLeg={s}Thigh/LowerLeg={s}Shin/Foot={s}Foot",
    ),
    "Rokoko": _MIXAMO._replace(
        trunk="hips=Hips/spine=Spine1/chest=Spine2/=Spine3/upperChest=Spine4/neck=Neck/head=Head",
        leg="UpperLeg={s}Thigh/LowerLeg={s}Shin/Foot={s}Foot/Toes={s}Toe",
        fingers="{s}Finger{k0}{bit}",
        palm="{s}Finger{k0}Metacarpal",
    ),
    "Xsens": _UNITY._replace(
        trunk="hips=Pelvis/spine=L5/chest=L3/=T12/upperChest=T8/neck=Neck/head=Head",
        arm="Shoulder={s}Shoulder/UpperArm={s}UpperArm/LowerArm={s}ForeArm/Hand={s}Hand",
        leg="UpperLeg={s}UpperLeg/LowerLeg={s}LowerLeg/Foot={s}Foot/Toes={s}Toe",
        fingers="",
    ),
    "MVN and old BVH": Scheme(
        "hips=Hips/spine=Chest/chest=Chest2/=Chest3/upperChest=Chest4/neck=Neck/head=Head",
        "Shoulder={s}Collar/UpperArm={s}Shoulder/LowerArm={s}Elbow/Hand={s}Wrist",
        "UpperLeg={s}Hip/LowerLeg={s}Knee/Foot={s}Ankle/Toes={s}Toe",
        ("Left", "Right"),
    ),
    "Perception Neuron": _MIXAMO._replace(
        trunk="hips=Hips/spine=Spine/chest=Spine1/upperChest=Spine2/neck=Neck/=Neck1/head=Head",
        leg="UpperLeg={s}UpLeg/LowerLeg={s}Leg/Foot={s}Foot",
        palm="{s}InHand{digit}",
    ),
    "OptiTrack": _UNREAL._replace(
        trunk="hips=Hip/spine=Ab/chest=Chest/neck=Neck/head=Head",
        arm="Shoulder={s}Shoulder/UpperArm={s}UArm/LowerArm={s}FArm/Hand={s}Hand",
        leg="UpperLeg={s}Thigh/LowerLeg={s}Shin/Foot={s}Foot/Toes={s}Toe",
        sides=("L", "R"),
        fingers="{s}{digit}{k}",
        digits="Thumb Index Middle Ring Pinky",
    ),
    "Acclaim of Vicon and CMU": Scheme(
        "hips=root/spine=lowerback/chest=upperback/upperChest=thorax/neck=lowerneck/=upperneck/head=head",
        "Shoulder={s}clavicle/UpperArm={s}humerus/LowerArm={s}radius/Hand={s}wrist/={s}hand/={s}fingers",
        "={s}hipjoint/UpperLeg={s}femur/LowerLeg={s}tibia/Foot={s}foot/Toes={s}toes",
        ("l", "r"),
    ),
    "CMU as BVH": Scheme(
        "hips=Hips/spine=LowerBack/chest=Spine/upperChest=Spine1/neck=Neck/=Neck1/head=Head",
        _MIXAMO.arm + "/={s}FingerBase",
        "={S}HipJoint/" + _MIXAMO.leg,
        ("Left", "Right"),
    ),
    "Second Life": Scheme(
        "hips=mPelvis/spine=mSpine1/=mSpine2/chest=mTorso/=mSpine3/=mSpine4/upperChest=mChest/neck=mNeck/head=mHead",
        "Shoulder=mCollar{s}/UpperArm=mShoulder{s}/LowerArm=mElbow{s}/Hand=mWrist{s}",
        "UpperLeg=mHip{s}/LowerLeg=mKnee{s}/Foot=mAnkle{s}/=mFoot{s}/Toes=mToe{s}",
        ("Left", "Right"),
        "mHand{digit}{k}{s}",
    ),
    "MakeHuman": Scheme(
        "hips=root/spine=spine05/=spine04/chest=spine03/=spine02/upperChest=spine01/neck=neck01/=neck02/=neck03/head=head",
        "Shoulder=clavicle.{s}/=shoulder01.{s}/UpperArm=upperarm01.{s}/=upperarm02.{s}/LowerArm=lowerarm01.{s}"
        "/=lowerarm02.{s}/Hand=wrist.{s}",
        "=pelvis.{s}/UpperLeg=upperleg01.{s}/=upperleg02.{s}/LowerLeg=lowerleg01.{s}/=lowerleg02.{s}/Foot=foot.{s}"
        "/Toes=toe1-1.{s}",
        ("L", "R"),
        "finger{k0}-{k}.{s}",
        palm="metacarpal{k0}.{s}",
    ),
    "Roblox": _UNITY._replace(
        trunk="=HumanoidRootPart/hips=LowerTorso/spine=UpperTorso/head=Head",
        arm="UpperArm={s}UpperArm/LowerArm={s}LowerArm/Hand={s}Hand",
        leg="UpperLeg={s}UpperLeg/LowerLeg={s}LowerLeg/Foot={s}Foot",
        fingers="",
    ),
    "MikuMikuDance": _DANCE,
    "MikuMikuDance, English": _DANCE_ENGLISH,
    "MikuMikuDance, romaji": Scheme(
        "hips=sentaa/spine=jouhanshin/neck=kubi/head=atama",
        "Shoulder={s}kata/UpperArm={s}ude/LowerArm={s}hiji/Hand={s}tekubi",
        "=kahanshin/UpperLeg={s}ashi/LowerLeg={s}hiza/Foot={s}ashikubi/Toes={s}tsumasaki",
        ("hidari", "migi"),
    ),
    "Kinect": Scheme(
        "hips=SpineBase/spine=SpineMid/chest=SpineShoulder/neck=Neck/head=Head",
        "UpperArm=Shoulder{s}/LowerArm=Elbow{s}/Hand=Wrist{s}/=Hand{s}/=HandTip{s}",
        "UpperLeg=Hip{s}/LowerLeg=Knee{s}/Foot=Ankle{s}/Toes=Foot{s}",
        ("Left", "Right"),
    ),
    "mocopi": Scheme(
        "hips=root/spine=torso_1/=torso_2/=torso_3/chest=torso_4/=torso_5/=torso_6/upperChest=torso_7/neck=neck_1/=neck_2"
        "/head=head",
        "Shoulder={s}_shoulder/UpperArm={s}_up_arm/LowerArm={s}_low_arm/Hand={s}_hand",
        "UpperLeg={s}_up_leg/LowerLeg={s}_low_leg/Foot={s}_foot/Toes={s}_toes",
        ("l", "r"),
    ),
    "Azure Kinect": Scheme(
        "hips=PELVIS/spine=SPINE_NAVEL/chest=SPINE_CHEST/neck=NECK/head=HEAD",
        "Shoulder=CLAVICLE_{s}/UpperArm=SHOULDER_{s}/LowerArm=ELBOW_{s}/Hand=WRIST_{s}/=HAND_{s}/=HANDTIP_{s}",
        "UpperLeg=HIP_{s}/LowerLeg=KNEE_{s}/Foot=ANKLE_{s}/Toes=FOOT_{s}",
        ("LEFT", "RIGHT"),
    ),
    "Maya": Scheme(
        "=root_jnt/hips=C_pelvis_jnt/spine=C_spine_01_jnt/chest=C_spine_02_jnt/upperChest=C_chest_jnt/neck=C_neck_jnt"
        "/head=C_head_jnt",
        "Shoulder={s}_clavicle_jnt/UpperArm={s}_shoulder_jnt/LowerArm={s}_elbow_jnt/Hand={s}_wrist_jnt",
        "UpperLeg={s}_hip_jnt/LowerLeg={s}_knee_jnt/Foot={s}_ankle_jnt/Toes={s}_ball_jnt",
        ("L", "R"),
        "{s}_{digit}_0{k}_jnt",
        "thumb index middle ring pinky",
    ),
    "Advanced Skeleton": Scheme(
        "hips=Root_M/spine=Spine1_M/chest=Spine2_M/upperChest=Chest_M/neck=Neck_M/head=Head_M",
        "Shoulder=Scapula_{s}/UpperArm=Shoulder_{s}/=ShoulderPart1_{s}/LowerArm=Elbow_{s}/=ElbowPart1_{s}/Hand=Wrist_{s}",
        "UpperLeg=Hip_{s}/=HipPart1_{s}/LowerLeg=Knee_{s}/Foot=Ankle_{s}/Toes=Toes_{s}",
        ("L", "R"),
        "{digit}Finger{k}_{s}",
    ),
    "Auto-Rig Pro": Scheme(
        "=root/hips=root.x/spine=spine_01.x/chest=spine_02.x/upperChest=spine_03.x/neck=neck.x/head=head.x",
        "Shoulder=shoulder.{s}/UpperArm=arm_stretch.{s}/LowerArm=forearm_stretch.{s}/Hand=hand.{s}",
        "UpperLeg=thigh_stretch.{s}/LowerLeg=leg_stretch.{s}/Foot=foot.{s}/Toes=toes_01.{s}",
        ("l", "r"),
        "c_{digit}{k}.{s}",
        "thumb index middle ring pinky",
    ),
    "Tripo": _CREATOR._replace(
        trunk="=Root/hips=Hip/spine=Waist/chest=Spine01/upperChest=Spine02/neck=NeckTwist01/=NeckTwist02/head=Head",
        leg="=Pelvis/UpperLeg={s}_Thigh/LowerLeg={s}_Calf/Foot={s}_Foot/Toes={s}_ToeBase",
        sides=("L", "R"),
        fingers="",
    ),
    "Meshy": _MIXAMO._replace(
        trunk="hips=Hips/spine=Spine02/chest=Spine01/upperChest=Spine/neck=neck/head=Head/=head_end", fingers=""
    ),
    "DeepMotion": Scheme(
        "hips=hips_JNT/spine=spine_JNT/chest=spine1_JNT/upperChest=spine2_JNT/neck=neck_JNT/head=head_JNT",
        "Shoulder={s}_shoulder_JNT/UpperArm={s}_arm_JNT/LowerArm={s}_forearm_JNT/Hand={s}_hand_JNT",
        "UpperLeg={s}_upleg_JNT/LowerLeg={s}_leg_JNT/Foot={s}_foot_JNT/Toes={s}_toebase_JNT",
        ("l", "r"),
        "{s}_hand{digit}{k}_JNT",
    ),
    "Synty": Scheme(
        "=Root/hips=Hips/spine=Spine_01/chest=Spine_02/upperChest=Spine_03/neck=Neck/head=Head",
        "Shoulder=Clavicle_{s}/UpperArm=Shoulder_{s}/LowerArm=Elbow_{s}/Hand=Hand_{s}",
        "UpperLeg=UpperLeg_{s}/LowerLeg=LowerLeg_{s}/Foot=Ankle_{s}/Toes=Ball_{s}/=Toes_{s}",
        ("L", "R"),
    ),
    "VRChat": _DANCE_ENGLISH._replace(
        trunk="hips=Hips/spine=Spine/chest=Chest/neck=Neck/head=Head",
        arm="Shoulder={s} shoulder/UpperArm={s} arm/LowerArm={s} elbow/Hand={s} wrist",
        leg="UpperLeg={s} leg/LowerLeg={s} knee/Foot={s} ankle/Toes={s} toe",
        sides=("Left", "Right"),
        fingers="{digit}{k}_{s0}",
        digits="Thumb IndexFinger MiddleFinger RingFinger LittleFinger",
    ),
    "IMVU": Scheme(
        "hips=PelvisNode/spine=Spine01/chest=Spine02/upperChest=Spine03/neck=Neck01/head=Head",
        "Shoulder={s}Clavicle/UpperArm={s}Bicep/LowerArm={s}Elbow/Hand={s}Wrist",
        "UpperLeg={s}Thigh/LowerLeg={s}Calf/Foot={s}Foot/Toes={s}Toes",
        ("lf", "rt"),
    ),
    "Bandai-Namco": Scheme(
        "=joint_Root/hips=Hips/spine=Spine/chest=Chest/neck=Neck/head=Head",
        "Shoulder=Shoulder_{s}/UpperArm=UpperArm_{s}/LowerArm=LowerArm_{s}/Hand=Hand_{s}",
        "UpperLeg=UpperLeg_{s}/LowerLeg=LowerLeg_{s}/Foot=Foot_{s}/Toes=Toes_{s}",
        ("L", "R"),
    ),
    "ARKit": Scheme(
        "=root/hips=hips_joint/spine=spine_1_joint/=spine_2_joint/=spine_3_joint/chest=spine_4_joint/=spine_5_joint"
        "/=spine_6_joint/upperChest=spine_7_joint/neck=neck_1_joint/=neck_2_joint/head=head_joint",
        "Shoulder={s}_shoulder_1_joint/UpperArm={s}_arm_joint/LowerArm={s}_forearm_joint/Hand={s}_hand_joint",
        "UpperLeg={s}_upLeg_joint/LowerLeg={s}_leg_joint/Foot={s}_foot_joint/Toes={s}_toes_joint/={s}_toesEnd_joint",
        ("left", "right"),
        "{s}_hand{digit}_{k}_joint",
        palm="{s}_hand{digit}Start_joint",
    ),
    "GENEA": Scheme(
        "=body_world/hips=b_root/spine=b_spine0/chest=b_spine1/=b_spine2/upperChest=b_spine3/neck=b_neck0/head=b_head",
        "Shoulder={s}_shoulder/UpperArm={s}_arm/={s}_arm_twist/LowerArm={s}_forearm/={s}_wrist_twist/Hand={s}_wrist",
        "UpperLeg={s}_upleg/LowerLeg={s}_leg/Foot={s}_foot",
        ("b_l", "b_r"),
        "{s}_{digit}{k}",
        "thumb index middle ring pinky",
        palm="{s}_{digit}0",
    ),
    "BlazePose": Scheme(
        "hips=pelvis/spine=spine/neck=neck/head=head",
        "UpperArm={s}_shoulder/LowerArm={s}_elbow/Hand={s}_wrist",
        "UpperLeg={s}_hip/LowerLeg={s}_knee/Foot={s}_ankle/Toes={s}_foot_index",
        ("left", "right"),
    ),
    "anatomy": Scheme(
        "hips=Pelvis/spine=Lumbar/chest=Thorax/neck=Cervical/head=Skull",
        "Shoulder=Scapula_{s}/UpperArm=Humerus_{s}/LowerArm=Ulna_{s}/Hand=Hand_{s}",
        "UpperLeg=Femur_{s}/LowerLeg=Tibia_{s}/Foot=Foot_{s}",
        ("L", "R"),
        has_all_names=False,
    ),
    "Chinese": Scheme(
        "hips=骨盆/spine=脊椎1/chest=脊椎2/neck=脖子/head=头",
        "Shoulder={s}肩/UpperArm={s}上臂/LowerArm={s}前臂/Hand={s}手",
        "UpperLeg={s}大腿/LowerLeg={s}小腿/Foot={s}脚/Toes={s}脚趾",
        ("左", "右"),
    ),
    "German": Scheme(
        "hips=Becken/spine=Wirbel1/chest=Wirbel2/neck=Hals/head=Kopf",
        "Shoulder=Schulter_{s}/UpperArm=Oberarm_{s}/LowerArm=Unterarm_{s}/Hand=Hand_{s}",
        "UpperLeg=Oberschenkel_{s}/LowerLeg=Unterschenkel_{s}/Foot=Fuss_{s}/Toes=Zehen_{s}",
        ("L", "R"),
        has_all_names=False,
    ),
    "Russian": Scheme(
        "hips=Таз/spine=Спина/chest=Грудь/neck=Шея/head=Голова",
        "Shoulder=Ключица_{s}/UpperArm=Плечо_{s}/LowerArm=Предплечье_{s}/Hand=Кисть_{s}",
        "UpperLeg=Бедро_{s}/LowerLeg=Голень_{s}/Foot=Стопа_{s}/Toes=Носок_{s}",
        ("Л", "П"),
        has_all_names=False,
    ),
    "numbered legs": _UNREAL._replace(
        arm="Shoulder=shoulder_{s}/UpperArm=arm_1_{s}/LowerArm=arm_2_{s}/Hand=hand_{s}",
        leg="UpperLeg=leg_1_{s}/LowerLeg=leg_2_{s}/Foot=foot_{s}",
    ),
}  # fmt: skip
