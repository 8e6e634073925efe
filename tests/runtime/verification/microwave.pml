/* The one-minute microwave, written by hand for SPIN: a state is what lies between two turns.

   PERIOD is that of the rounds in milliseconds. A machine that has just come to a state enters it
   in its next turn: then `was` is not `is`. What a turn read is forgotten at its end. */

#define NEVER 9 /* no previous state, and no message */
#define longer(elapsed, limit) (elapsed > limit)
#define pass(elapsed, limit) elapsed = elapsed + PERIOD; \
    if :: elapsed > limit -> elapsed = limit + 1 :: else fi

#define CHECK 0
#define ADD 1
#define DECREMENT 2

#define OFF 0
#define ON 1
#define ARMED 2

byte turn, minutes;
byte timer = CHECK, timer_was = NEVER, cooker = OFF, cooker_was = NEVER;
byte lamp = OFF, lamp_was = NEVER, alarm = OFF, alarm_was = NEVER;
int in_check, in_ringing; /* milliseconds */
byte time_left = NEVER;
bit door, button;

#define left (time_left == 1)

active proctype oven() {
  bit seen;
  do
  :: atomic { turn == 0 ->
       if :: timer == CHECK && timer_was == CHECK -> pass(in_check, 60000) :: else fi;
       if :: alarm == ON && alarm_was == ON -> pass(in_ringing, 2000) :: else fi;
       if :: door = 0 :: door = 1 fi;
       if :: button = 0 :: button = 1 fi;
       seen = left;
       if
       :: timer != timer_was ->
            timer_was = timer;
            if
            :: timer == CHECK -> time_left = (minutes > 0)
            :: timer == ADD -> minutes = minutes + 1
            :: timer == DECREMENT -> minutes = minutes - 1
            fi
       :: else
       fi;
       if
       :: timer == CHECK && longer(in_check, 60000) && minutes > 0 && !door && seen ->
            timer = DECREMENT; in_check = 0
       :: timer == CHECK && !(longer(in_check, 60000) && minutes > 0 && !door && seen) &&
          button && !door && minutes < 15 ->
            timer = ADD; in_check = 0
       :: timer == ADD && !button -> timer = CHECK; time_left = 1
       :: timer == DECREMENT -> timer = CHECK
       :: else
       fi;
       door = 0; button = 0; seen = 0; turn = 1 }
  :: atomic { turn == 1 ->
       if :: door = 0 :: door = 1 fi;
       cooker_was = cooker;
       if
       :: cooker == OFF && left && !door -> cooker = ON
       :: cooker == ON && (door || !left) -> cooker = OFF
       :: else
       fi;
       door = 0; turn = 2 }
  :: atomic { turn == 2 ->
       if :: door = 0 :: door = 1 fi;
       lamp_was = lamp;
       if
       :: lamp == OFF && (door || left) -> lamp = ON
       :: lamp == ON && !door && !left -> lamp = OFF
       :: else
       fi;
       door = 0; turn = 3 }
  :: atomic { turn == 3 ->
       alarm_was = alarm;
       if
       :: alarm == OFF && left -> alarm = ARMED
       :: alarm == ARMED && !left -> alarm = ON
       :: alarm == ON && longer(in_ringing, 2000) -> alarm = OFF; in_ringing = 0
       :: else
       fi;
       turn = 0 }
  od
}
