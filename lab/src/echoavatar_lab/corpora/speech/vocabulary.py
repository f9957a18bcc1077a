"""The words and sentence shapes of the rehearsal scripts: plain dictionary words, written for this project."""

_TEXTS = {
    "noun": (
        "house garden river table window letter picture story kitchen bottle mountain bridge ticket camera "
        "blanket market teacher neighbor doctor problem question answer number machine engine paper corner "
        "summer winter morning dinner coffee music movie island ocean forest village city station train "
        "basket ladder hammer button pocket mirror candle flower apple carrot potato cookie farmer captain "
        "dragon monkey rabbit chicken elephant computer telephone umbrella holiday birthday company"
    ),
    "many": (
        "books cats dogs cars trees birds boxes friends people children lights doors windows songs stories "
        "letters apples flowers tickets pictures buttons chairs bottles minutes hours days mistakes ideas"
    ),
    "adj": (
        "old new red green blue quiet noisy empty broken pretty heavy funny lovely lonely clever famous "
        "simple golden yellow purple modern perfect dirty happy gentle hungry wooden silver common secret "
        "narrow hollow sudden bitter sweet strange warm cold bright dark soft hard slow quick fresh dry"
    ),
    "size": "big huge tiny small little enormous giant tall wide long short deep thick thin massive",
    "verb": (
        "saw found lost took brought carried opened closed painted cleaned fixed sold bought dropped "
        "followed watched noticed remembered forgot showed hid moved lifted pushed pulled touched answered"
    ),
    "do": (
        "see find take bring carry open close paint clean fix sell buy drop follow watch notice remember "
        "forget show hide move lift push pull touch answer change finish visit borrow collect repair"
    ),
    "go": "walked ran went drove traveled hurried wandered climbed danced returned",
    "name": ("Anna Peter Maria Robert Lucy Thomas Emma Daniel Laura Michael Susan David Helen Martin Nancy Oliver"),
    "number": "two three four five six seven eight nine ten eleven twelve twenty thirty fifty hundred",
    "time": "yesterday today tonight tomorrow sometimes usually already recently finally again",
    "day": "Monday Tuesday Wednesday Thursday Friday Saturday Sunday",
    "feel": "happy angry sad tired proud sorry worried excited afraid surprised nervous calm ready",
    "adverb": "really quickly slowly simply carefully quietly suddenly nearly almost never always",
    "place": "kitchen garden city station market village forest office school hospital theater library",
    "weather": "raining snowing windy sunny cloudy foggy freezing burning pouring",
}
WORDS = {slot: tuple(text.split()) for slot, text in _TEXTS.items()}

PHRASES: dict[str, tuple[str, ...]] = {
    "np": ("the {noun}", "the {adj} {noun}", "my {noun}", "a {adj} {noun}", "your {adj} {noun}", "that {noun}"),
    "subject": ("I", "we", "they", "she", "he", "{name}", "my {noun}", "the {adj} {noun}", "{name} and {name}"),
    "object": ("{np}", "{np}", "{number}^count {many}", "all^size the {many}", "{np} and {np}"),
    "where": ("in the {place}", "near the {noun}", "behind the {adj} {noun}", "at the {place}", "by the {noun}"),
    "clause": (
        "{subject} {verb} {object}",
        "{subject} {go} to the {place}",
        "{subject} {verb} {object} {where}",
        "{subject} {adverb} {verb} {np}",
        "it was {weather} {where}",
        "{subject} {verb} {np} because {subject} {verb} {np}",
    ),
    "opener": ("well,", "you know,", "okay,", "so,", "look,", "honestly,", "actually,", "listen,"),
    "hedge": ("I think", "I guess", "maybe", "I believe", "they say", "it seems", "I am sure"),
    "when": ("after {day}", "before the {noun}", "{time}", "on {day}", "in the {adj} {noun}"),
    "sizes": ("{size}", "very {size}", "{adverb} {size}"),
}

SENTENCES: dict[str, tuple[str, ...]] = {
    "statement": (
        "{clause}.",
        "{clause} {when}.",
        "{when}, {clause}.",
        "{clause}, and then {clause}.",
        "the {noun} was {adj} and *{adj}.",
        "{subject} {verb} the *{adj} {noun} {where}.",
        "{clause} while {clause}.",
        "there is a {adj} {noun} {where}.",
    ),
    "opener": (
        "{opener} {hedge} {clause}.",
        "{opener} {clause}, {hedge}.",
        "{opener} [p] {hedge} {clause}.",
        "{opener} {clause}, and {clause}.",
        "{hedge}, {opener} {clause} {when}.",
        "{opener} it is {adverb} *{adj}.",
        "{opener} {hedge} it was the *{noun}.",
    ),
    "but": (
        "{clause}, but {subject} *{verb} {np}.",
        "I wanted to {do} {np}, but it was too *{adj}.",
        "{clause}, but^contrast {subject} was {adverb} *{feel}.",
        "it looks {adj}, but [p] it is *{adj}^contrast.",
        "{name} was {feel}, but {name} was *{feel}^contrast.",
        "she likes the {noun}, but^contrast not^negation the *{noun}.",
        "{clause}, but [p] {clause}.",
    ),
    "question": (
        "did^question you {do} {np}?",
        "where^question is {np}?",
        "why^question did {subject} {do} {object}?",
        "what^question happened to the *{noun}?",
        "do^question you really want to {do} {np}?",
        "who^question {verb} the *{adj} {noun}?",
        "how^question many {many} did {name} {do}?",
        "can^question you *{do} it {when}?",
        "is^question it the {adj} one or the *{adj}^contrast one?",
    ),
    "list": (
        "we need {many}, {many}, {many}, and *{many}.",
        "there were {many}, {many}, and *{many} {where}.",
        "first^count the {noun}, second^count the {noun}, and third^count the *{noun}.",
        "I like {adj} {many}, {adj} {many}, and {adj} {many}.",
        "{name}, {name}, and {name} {verb} {object}.",
        "bring the {noun}, the {noun}, the {noun}, and the {adj} {noun}.",
        "{day}, {day}, and *{day}.",
    ),
    "contrast": (
        "not^negation the *{adj} one, the *{adj}^contrast one.",
        "on one^contrast hand, {clause}. [p] on the other^contrast hand, {clause}.",
        "this^deixis {noun} is {adj}, and that^deixis {noun} is *{adj}^contrast.",
        "either^contrast we {do} it {time}, or^contrast we *{do} it.",
        "some people {do} the {noun}, others^contrast *{do} it.",
        "I said *{noun}, not^negation *{noun}.",
        "{name} is {sizes}^size, {name} is {sizes}^contrast.",
    ),
    "size": (
        "it was about *this^size wide.",
        "the {noun} was {sizes}^size.",
        "a {size}^size {noun}, {adverb} *{size}^size.",
        "the fish was *this^size long, and {sizes}^size.",
        "{subject} {verb} an *enormous^size {noun} {where}.",
        "it was so^size *{size}^size that nobody^negation could {do} it.",
        "only a *tiny^size {noun}, no bigger than^size a {noun}.",
        "the whole^size {place} was full of {many}.",
    ),
    "enumeration": (
        "first,^count {clause}. [p] second,^count {clause}.",
        "there are *{number}^count reasons. [p] one,^count {clause}. [p] two,^count {clause}.",
        "I counted {number}^count, {number}^count, maybe *{number}^count {many}.",
        "number^count {number} is the {adj} {noun}.",
        "{number}^count {many} and {number}^count {many}.",
        "one^count {noun}, two^count {many}, *three^count {many}.",
        "we had only *{number}^count {many} {when}.",
    ),
    "negation": (
        "no,^negation do not^negation *{do} it.",
        "{subject} *never^negation {verb} {np}.",
        "stop,^negation [p] that is *not^negation your {noun}.",
        "nobody^negation {verb} {object}.",
        "I do not^negation want to {do} *any {many}.",
        "there is *nothing^negation {where}.",
        "no^negation way, {name} *never^negation {verb} it.",
        "it is not^negation {adj}, not^negation at *all^negation.",
    ),
    "story": (
        "{when}, {clause}. [p] suddenly, {clause}. [p] and then {clause}.",
        "once there was a {adj} {noun}. [p] it {go} to the {place}. [p] it was {feel}.",
        "{name} {verb} {np}. [p] {name} was {adverb} *{feel}.",
        "so {clause}, [p] and what did {name} do? [p] {name} *{verb} {np}.",
        "we {go} {where}. [p] {clause}. [p] it was *{weather}.",
        "I was {feel}, [p] {adverb} *{feel}.",
        "{clause}. [p] imagine^greeting that.",
    ),
    "if": (
        "if {clause}, {clause}.",
        "when {clause}, I was *{feel}.",
        "if it is {weather} {when}, we *{do} the {noun}.",
        "whenever {name} {verb} {np}, {name} {verb} {np}.",
        "if you {do} it {adverb}, it is *{adj}.",
        "until {day}, {clause}.",
        "if^contrast not^negation {time}, then *{day}.",
    ),
    "pointing": (
        "look over *there,^deixis {where}.",
        "*you,^deixis *me,^deixis and *everyone.^deixis",
        "put it *here,^deixis not^negation *there.^deixis",
        "that^deixis one is *mine,^deixis and this^deixis one is *yours.^deixis",
        "come *here^deixis and {do} this^deixis {noun}.",
        "up^deixis there you see the *{adj} {noun}.",
        "the {place} is on the *left,^deixis the {place} is on the *right.^deixis",
        "we^deixis all {do} it *together.^deixis",
    ),
    "reaction": (
        "no^negation *way!",
        "oh, that is *{adj}!",
        "wow, [p] *{number}^count {many}!",
        "what a *{adj} {noun}!",
        "I am so *{feel}!",
        "great, {clause}!",
        "come on, {do} the *{noun}!",
    ),
    "backchannel": ("right.", "yes, yes.", "I see.", "okay, [p] sure.", "oh really?", "of course.", "yeah, I know."),
    "greeting": (
        "*hello,^greeting my name is {name}.",
        "good *morning,^greeting {name}.",
        "hi^greeting everyone, [p] *welcome^greeting to the {place}.",
        "*goodbye,^greeting and thank^greeting you all.",
        "*hello,^greeting how^question are you {time}?",
        "*welcome^greeting back, {name} and {name}.",
        "thank^greeting you, thank you *very much.",
    ),
}
