"""The tables of `eagor.perception.words`: names for one thing, wider words, irregular plurals, words that describe.

They cover COCO's 80 classes, and what LVIS, Objects365 and Open Images call things of every day.
"""

from __future__ import annotations


def _lines(text: str) -> tuple[tuple[str, ...], ...]:
    return tuple(tuple(name.strip() for name in line.split(",")) for line in text.strip().splitlines())


# Names of one thing, in the singular. What "the remote" or "the ball" is, at home or in the street, is meant.
GROUPS = _lines("""
person, human, human being, somebody, someone, pedestrian, passenger, guest, visitor, bystander
bicycle, bike, cycle, pushbike, push bike, pedal cycle
car, automobile, motor car, motorcar, auto
motorcycle, motorbike, motor bike, motor cycle, moped, motor scooter
airplane, aeroplane, plane, aircraft, jet, airliner, jet plane
bus, coach, omnibus, double decker
train, railway train, locomotive
truck, lorry, pickup truck, pick up truck, pickup
boat, ship, rowboat, sailboat, sailing boat, motorboat, canoe, kayak, dinghy, yacht, vessel, ferry
traffic light, stoplight, stop light, traffic signal, traffic lights
fire hydrant, hydrant, fireplug, fire plug
stop sign, stopsign
parking meter, parkmeter
bench, park bench
bird, wild bird
cat, kitty, kitten, house cat, pussycat
dog, doggy, puppy, pup, hound
horse, pony, foal
sheep, lamb animal, ewe
cow, cattle, calf
backpack, rucksack, knapsack, back pack, school bag, schoolbag, daypack
umbrella, parasol, brolly, sunshade
handbag, purse, hand bag, shoulder bag, tote bag, ladies bag
tie, necktie, neck tie
suitcase, travel case, travel bag, roller bag, trolley case
frisbee, flying disc, flying disk
skis, ski, pair of skis
sports ball, ball, baseball, football, soccer ball, basketball, volleyball, tennis ball, beach ball, rugby ball
baseball bat
baseball glove, baseball mitt, catcher's mitt, catchers mitt, mitt
skateboard, skate board, longboard
surfboard, surf board
tennis racket, racket, racquet, tennis racquet, badminton racket
bottle, flask, water bottle, wine bottle, beer bottle
wine glass, wineglass, wine goblet, glass, drinking glass, goblet, champagne glass, champagne flute
cup, mug, coffee cup, tea cup, teacup, coffee mug, beaker
fork, table fork
knife, kitchen knife, table knife, bread knife, steak knife
spoon, teaspoon, tablespoon, soup spoon
bowl, soup bowl, salad bowl
sandwich, sub sandwich, toastie, panini
orange, orange fruit, mandarin, mandarin orange, tangerine, clementine
hot dog, hotdog, hot dogs
donut, doughnut, dough nut
cake, birthday cake, gateau
couch, sofa, settee, loveseat, love seat, divan, studio couch, chesterfield, sofa bed
potted plant, plant, house plant, houseplant, pot plant, plant pot, flowerpot, flower pot, indoor plant
dining table, table, kitchen table, dinner table, dinning table, kitchen dining room table, desk
toilet, lavatory, toilet seat, toilet bowl, wc, loo, commode
tv, television, television set, tv set, tv monitor, tv screen, telly, flat screen, flatscreen, monitor, screen, \
    computer monitor, display, computer screen
laptop, laptop computer, notebook computer, macbook, portable computer
mouse, computer mouse
remote, remote control, remote controller, tv remote, clicker
keyboard, computer keyboard
cell phone, mobile phone, cellphone, phone, smartphone, \
    smart phone, cellular telephone, telephone, iphone, mobile, handphone
microwave, microwave oven
oven, stove, cooker, kitchen range, kitchen stove, gas stove, hob, cooktop, stovetop
sink, washbasin, wash basin, hand basin, basin, washstand, kitchen sink, bathroom sink
refrigerator, fridge, icebox, fridge freezer, freezer
book, textbook, novel, hardback, paperback
clock, wall clock, alarm clock
vase, flower vase
scissors, pair of scissors, shears
teddy bear, teddy, stuffed bear, stuffed toy, stuffed animal, cuddly toy, plush toy, soft toy, plushie
hair drier, hair dryer, hairdryer, hairdrier, blow dryer, blow drier
toothbrush, tooth brush
lamp, table lamp, desk lamp, floor lamp, standing lamp, light, bedside lamp
street light, street lights, street lamp, streetlight, lamppost, lamp post
rug, carpet, mat
picture, painting, picture frame, framed picture, wall art, poster
bookshelf, bookcase, book shelf, shelf, shelves, shelving
cabinet, cupboard, sideboard
wardrobe, closet, armoire
nightstand, bedside table, night stand, night table
dresser, chest of drawers, bureau
bathtub, bath, tub, bath tub
shower, shower cabin, shower stall
trash can, waste container, garbage can, rubbish bin, dustbin, trash bin, \
    trash bin can, waste bin, wastebasket, waste basket, bin, garbage bin
armchair, easy chair, recliner, club chair
stool, bar stool, footstool
pillow, cushion
curtain, drape, drapes, window curtain
window blind, blinds, blind, shutter
faucet, tap, water tap
power outlet, socket, power socket, electrical outlet, wall socket
washing machine, washer, washing machine drying machine, clothes washer
dishwasher, dish washer
air conditioner, ac unit, aircon
fan, ceiling fan, electric fan
ladder, stepladder, step ladder
stairs, staircase, stairway
elevator, lift
door, doorway, front door
speaker, loudspeaker, loud speaker
headphones, headphone, headset, earphone
desktop computer, pc, computer box, desktop
glasses, eyeglasses, spectacles, eyeglass
sunglasses, sunglass
sneaker, sneakers, trainer shoe, running shoe, athletic shoe
hat, cap, headwear
jacket, coat
trousers, pants, slacks
jug, pitcher, carafe
pan, frying pan, skillet, saucepan
kettle, teakettle, tea kettle
towel, bath towel, hand towel
toilet paper, toilet tissue, toilet roll
tissue box, tissue
whiteboard, white board
blackboard, chalkboard
van, minivan
human face, face
cookie, biscuit
potato, spud
french fries, fries, chips fries
""")

DRINKING = ("wine", "beer", "water", "drinking", "champagne", "cocktail", "shot", "whisky")  # "glasses" to drink from
# Not what their last word is.
OTHER_THINGS = frozenset(
    {
        "magnifying glass",
        "looking glass",
        "stained glass",
        "disco ball",
        "crystal ball",
        "flower bed",
        "desktop computer",
    }
)

# Wider words and narrower ones: what the thing is among classes that are coarser, or finer, than the word.
WIDER: dict[str, tuple[str, ...]] = {
    "animal": ("bird", "cat", "dog", "horse", "sheep", "cow", "elephant", "bear", "zebra", "giraffe", "animal"),
    "pet": ("cat", "dog", "bird"),
    "vehicle": ("car", "bicycle", "motorcycle", "airplane", "bus", "train", "truck", "boat", "van"),
    "seat": ("chair", "couch", "bench", "stool", "armchair"),
    "seating": ("chair", "couch", "bench", "stool", "armchair"),
    "furniture": ("chair", "couch", "bed", "dining table", "bench", "cabinet", "wardrobe"),
    "bag": ("backpack", "handbag", "suitcase"),
    "luggage": ("suitcase", "backpack", "handbag"),
    "baggage": ("suitcase", "backpack", "handbag"),
    "food": ("banana", "apple", "sandwich", "orange", "broccoli", "carrot", "hot dog", "pizza", "donut", "cake"),
    "fruit": ("banana", "apple", "orange"),
    "vegetable": ("broccoli", "carrot"),
    "cutlery": ("fork", "knife", "spoon"),
    "silverware": ("fork", "knife", "spoon"),
    "crockery": ("cup", "bowl"),
    "tableware": ("bottle", "wine glass", "cup", "fork", "knife", "spoon", "bowl"),
    "appliance": ("microwave", "oven", "toaster", "refrigerator"),
    "kitchen appliance": ("microwave", "oven", "toaster", "refrigerator"),
    "electronics": ("tv", "laptop", "mouse", "remote", "keyboard", "cell phone"),
    "computer": ("laptop",),
    "toy": ("teddy bear", "sports ball", "kite", "frisbee"),
    "sofa chair": ("armchair", "couch"),
} | {
    narrow: (wide,)
    for wide, words in {
        "person": "man woman boy girl child kid baby toddler infant adult guy lady gentleman teenager cyclist rider "
        "driver player worker student teacher crowd people",
        "car": "taxi cab suv sedan hatchback jeep limousine limo convertible van",
        "truck": "firetruck",
        "motorcycle": "scooter vespa",
        "bird": "duck goose pigeon seagull gull parrot sparrow crow eagle owl chicken hen rooster swan ostrich",
        "dog": "poodle labrador bulldog terrier dachshund beagle",
        "cow": "bull ox",
        "chair": "armchair stool recliner rocker highchair deckchair",
        "couch": "sofabed futon",
        "bed": "bunk mattress cot crib",
        "cup": "espresso latte",
        "train": "tram subway metro streetcar",
        "potted plant": "fern cactus bonsai ficus palm",
        "book": "magazine notebook",
    }.items()
    for narrow in words.split()
}  # fmt: skip

# For errors: words that no class may fit, and what is of their kind.
_KIN = """
book: bookshelf bookcase shelf newspaper paper library folder
chair, couch, bed, dining table, bench: wardrobe cabinet cupboard shelf bookshelf bookcase drawer dresser \
    nightstand sideboard ottoman pouf hammock closet counter pillow cushion blanket duvet carpet rug mat curtain
clock: watch wristwatch timer
clock, vase, potted plant: picture painting poster mirror statue sculpture frame candle lamp light chandelier
potted plant, vase: flower tree bush grass bouquet rose tulip garden leaf
sink, toilet, toothbrush, hair drier: bath bathtub shower towel faucet tap soap shampoo washbasin bathroom
microwave, oven, toaster, refrigerator, sink: dishwasher kettle blender kitchen freezer stove hob counter \
    worktop mixer washer
bowl, cup, fork, knife, spoon: plate dish saucer tray chopsticks jug pot pan ladle teapot napkin
bottle, cup, wine glass: jar carafe water beer wine coffee tea milk juice drink
tv, laptop, keyboard, mouse, cell phone: computer printer tablet camera speaker radio console headphones charger \
    cable router projector
backpack, handbag, suitcase, umbrella: bag wallet box basket bucket trolley cart crate parcel
tie, handbag, backpack: shirt jacket coat dress hat cap shoe sock trousers jeans glasses scarf glove belt \
    clothes watch ring
stop sign, traffic light, parking meter, fire hydrant: sign signpost streetlight lamppost cone barrier pole
car, truck, bus, motorcycle, bicycle: tractor forklift ambulance scooter caravan trailer wheelchair stroller \
    pram wheel tyre tire
dog, cat, horse, sheep, cow: rabbit hamster goat pig monkey lion tiger fox deer fish wolf camel donkey squirrel
banana, apple, orange: pear grape strawberry lemon peach melon pineapple mango cherry kiwi
broccoli, carrot: tomato potato lettuce cucumber onion salad pepper cabbage corn
pizza, sandwich, hot dog, cake, donut: bread burger hamburger pasta rice soup cheese egg cookie chocolate ice \
    meat pie bagel croissant muffin fries
scissors, knife: hammer screwdriver saw drill tool pliers wrench pen pencil stapler
teddy bear, sports ball, kite, frisbee: doll lego puzzle balloon game
sports ball, tennis racket, skateboard, surfboard, skis: helmet net goal dumbbell golf hockey sled racquet
person: face hand head hair foot arm leg eye nose mouth statue mannequin
"""
KIN: dict[str, tuple[str, ...]] = {}
for _line in _KIN.strip().splitlines():
    _classes, _, _words = _line.partition(": ")
    for _word in _words.split():
        KIN[_word] = (*KIN.get(_word, ()), *_classes.split(", "))

IRREGULAR = {
    "people": "person", "persons": "person", "men": "man", "women": "woman", "children": "child", "kids": "kid",
    "ladies": "lady", "babies": "baby", "feet": "foot", "teeth": "tooth", "geese": "goose", "mice": "mouse",
    "oxen": "ox", "sheep": "sheep", "sheeps": "sheep", "fish": "fish", "deer": "deer", "cattle": "cattle",
    "knives": "knife", "shelves": "shelf", "bookshelves": "bookshelf", "leaves": "leaf", "loaves": "loaf",
    "wolves": "wolf", "calves": "calf", "scarves": "scarf", "halves": "half", "hooves": "hoof",
    "buses": "bus", "busses": "bus", "gases": "gas", "lenses": "lens", "shoes": "shoe", "toes": "toe",
    "canoes": "canoe", "cookies": "cookie", "pies": "pie", "hoodies": "hoodie", "brownies": "brownie",
    "movies": "movie", "teddies": "teddy", "tvs": "tv", "pcs": "pc", "axes": "axe", "cacti": "cactus",
    "scissors": "scissors", "broccolis": "broccoli", "skis": "ski", "skies": "ski", "aircraft": "aircraft",
    "stairs": "stairs", "glasses": "glasses",
}  # fmt: skip

# Before the noun: no part of what is asked for.
_OPENERS = """
a an the my our your his her its their this that these those some any all every each one another where wheres
is are was were find me show locate look for search see go to please can you i we want need which what whats
there here and closest nearest
"""
OPENERS = frozenset(_OPENERS.split())
# Words that tell one thing from another of its class, besides colours.
_DESCRIBING = """
big bigger biggest small smaller smallest large larger largest little tiny huge tall short long high low wide
narrow thin thick old new young antique modern vintage broken empty full open closed clean dirty wet dry left
right first second third last other wooden metal metallic plastic leather glass stone marble concrete fabric
velvet paper golden silver striped dotted checkered checked patterned colourful colorful transparent shiny
dark light bright pale round square oval rectangular soft hard heavy expensive cheap nice beautiful ugly
comfortable sitting standing lying parked moving running occupied free smiling male female wearing gray grey
"""
DESCRIBING = frozenset(_DESCRIBING.split())
